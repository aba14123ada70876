"""The run folder: weights, what made them, and how training went. Nothing in it is ever unpickled.

runs/NAME/model.safetensors   the weights after the last finished epoch
runs/NAME/config.json         everything needed to reproduce the run and to drive with it
runs/NAME/metrics.jsonl       one line an epoch
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from safetensors import SafetensorError
from safetensors.torch import load_file, save

from common import whole_file
from dataset.preprocess import DESCRIPTION
from model.errors import RunError
from model.network import SteeringNetwork

FORMAT: Final = 1
WEIGHTS, CONFIG, METRICS = "model.safetensors", "config.json", "metrics.jsonl"


def create_run(folder: Path, config: dict[str, Any]) -> None:
    """Make a run folder with its config. Raises RunError if there is one already."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise RunError(f"{folder}: this run exists already; give another --name") from None
    stored = {"format": FORMAT, "preprocessing": DESCRIPTION, **config}
    with whole_file(folder / CONFIG, overwrite=False) as part:
        part.write_text(json.dumps(stored, indent=2) + "\n", encoding="utf-8")


def save_weights(folder: Path, network: SteeringNetwork) -> None:
    """Replace the run's weights in one step: a full disk or a crash leaves the old ones."""
    weights = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    with whole_file(folder / WEIGHTS, overwrite=True) as part:
        part.write_bytes(save(weights))  # `save_file` would let nobody else read them


@contextlib.contextmanager
def kept_if_trained(folder: Path) -> Iterator[None]:
    """Around the training of the run in `folder`, which this process has made: if that is stopped before its first
    epoch is finished, the folder goes, and its name is free again."""
    try:
        yield
    finally:
        if not (folder / WEIGHTS).exists():
            shutil.rmtree(folder)


def add_metrics(folder: Path, metrics: dict[str, Any]) -> None:
    """Add a line of JSON, in which a measure that does not exist (NaN) is null."""
    metrics = {
        name: {key: None if isinstance(v, float) and math.isnan(v) else v for key, v in value.items()}
        if isinstance(value, dict)
        else value
        for name, value in metrics.items()
    }
    with (folder / METRICS).open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(metrics, allow_nan=False) + "\n")


def newest_run(runs: Path) -> Path:
    """The run whose weights were written last. Raises RunError if there is none."""
    weights = sorted(runs.glob(f"*/{WEIGHTS}"), key=lambda path: path.stat().st_mtime_ns)
    if not weights:
        raise RunError(f"{runs}: no trained run in it; train one with `bc-train`")
    return weights[-1].parent


def find_run(name: str | None, runs: Path) -> Path:
    """A run by name (in `runs`) or by path; the newest one without a name."""
    if name is None:
        return newest_run(runs)
    for folder in (runs / name, Path(name)):
        if (folder / WEIGHTS).is_file():
            return folder
    raise RunError(
        f"{runs / name}: no trained run there ({WEIGHTS} is missing); `bc-train --name {name}` makes it"
    )


def load_config(folder: Path) -> dict[str, Any]:
    """The run's config.json. Raises RunError if it is damaged, or newer than this toolkit."""
    path = folder / CONFIG
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
        version = config["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path}: cannot be read ({error}); was it written by bc-train?") from None
    if version != FORMAT:
        raise RunError(f"{path}: of format {version}, this toolkit reads format {FORMAT}; update the toolkit")
    if config.get("preprocessing") != DESCRIPTION:
        raise RunError(f"{path}: trained with another preprocessing than this toolkit's; train it again")
    return dict(config)


def load_network(folder: Path) -> SteeringNetwork:
    """The run's network, ready to predict. Raises RunError if its weights are damaged or of another shape."""
    path = folder / WEIGHTS
    network = SteeringNetwork()
    try:
        network.load_state_dict(load_file(path))
    except (OSError, SafetensorError) as error:
        raise RunError(f"{path}: cannot be read ({error}); train the run again") from None
    except RuntimeError:
        raise RunError(f"{path}: weights of another network than this toolkit's") from None
    return network.eval()


def checksum(folder: Path) -> str:
    """SHA-256 of the run's weights: a drive's log says with it which network drove."""
    with (folder / WEIGHTS).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
