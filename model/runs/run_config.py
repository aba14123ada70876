"""A run's config.json, and the weights that NAME and NAME/last mean. Needs no PyTorch."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from common.untrusted import read_bounded
from model.errors import RunError
from model.runs.network_of_run import picture_of
from model.runs.run_files import CHECKPOINT, CONFIG, LAST, WEIGHTS

FORMAT: Final = 4
DRIVABLE: Final = (1, 2, 3, 4)
"""Format 1 has fewer training settings. In format 2, the last layer may hold the answer scale. Up to format 3, the
only target is steering."""
MAX_CONFIG_BYTES: Final = 256 << 20  # a config.json names every log: 100,000 take 160 MB


def load_config(folder: Path) -> dict[str, Any]:
    """The run's config.json. Raises RunError if it is damaged, or newer than this toolkit."""
    path = config_folder(folder) / CONFIG
    try:
        config = json.loads(read_bounded(path, MAX_CONFIG_BYTES))
        version = config["format"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read ({error}); was it written by bc-train?") from None
    if version not in DRIVABLE:
        raise RunError(
            f"{path}: of format {version}, this toolkit reads {DRIVABLE[0]} to {FORMAT}; update the toolkit"
        )
    picture_of(config, path)  # raises RunError for another preprocessing
    return dict(config)


def config_folder(folder: Path) -> Path:
    """The folder of the run: NAME for both NAME and NAME/last."""
    return folder.parent if is_last_weights(folder) else folder


def weights_path(folder: Path) -> Path:
    """The file with the weights of a run, or of its last epoch (NAME/last)."""
    return folder / (CHECKPOINT if is_last_weights(folder) else WEIGHTS)


def is_last_weights(folder: Path) -> bool:
    """True for NAME/last, the weights after a run's last epoch."""
    return folder.name == LAST and (folder / CHECKPOINT).is_file()


def weights_checksum(folder: Path) -> str:
    """SHA-256 of the run's weights. A drive's log names its network by it."""
    with weights_path(folder).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
