"""The results of a run's evaluations: results.jsonl in its folder, one line a result.

A line has the time of the measurement and the SHA-256 of the weights, because more training changes the weights.
Results are not trusted: an invalid line is skipped and counted.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from common.untrusted import read_bounded
from model.errors import RunError
from model.runs.run_config import config_folder, weights_checksum
from model.runs.run_files import RESULTS_FILE, append_json_line

_MAX_BYTES: Final = 64 << 20  # a hundred thousand results

Way = Literal["frames", "recording", "simulator", "supervised"]
"""In a "supervised" drive, a person took over from the network (`bc-drive --takeover me`). Only earlier versions
write "recording": a network drove along a recording."""


class KeptResult(msgspec.Struct, frozen=True):
    measured_at: str  # UTC, ISO 8601
    way: Way
    weights_sha256: str
    result: dict[str, Any]  # as `bc-eval --json` prints it; of a supervised drive, as `drive.kept_drive` makes it


def keep_result(run: Path, way: Way, result: Mapping[str, Any]) -> None:
    """Add a result of the run's kept weights, or of its last ones (NAME/last). Raises RunWriteError if the folder
    cannot be written to."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    kept = KeptResult(now, way, weights_checksum(run), dict(result))
    append_json_line(config_folder(run) / RESULTS_FILE, msgspec.to_builtins(kept))


def kept_results(run: Path) -> tuple[list[KeptResult], int]:
    """The results in a run's folder, the oldest first, and the number of invalid lines."""
    path = run / RESULTS_FILE
    try:
        content = read_bounded(path, _MAX_BYTES)
    except FileNotFoundError:
        return [], 0
    except (OSError, ValueError) as error:
        raise RunError(f"{path}: cannot be read ({error}); remove it, and measure again") from None
    results, lines = [], [line for line in content.splitlines() if line.strip()]
    for line in lines:
        try:
            results.append(msgspec.convert(json.loads(line), KeptResult))
        except (ValueError, RecursionError):  # msgspec's errors are ValueErrors
            continue
    return results, len(lines) - len(results)
