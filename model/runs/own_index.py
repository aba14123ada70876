"""The logs of an index that is built for one run, to learn from takeovers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from common.location import Location
from common.random_access import is_there
from dataset import IndexConfig
from dataset.index.sessions import find_unchanged_log
from model.runs.reproduce import data_of_run


def logs_with_takeovers(
    run: Path, takeovers: Sequence[Location], sessions: Location, drives: Location
) -> tuple[list[Location], IndexConfig]:
    """The logs that `run` was trained on and those with takeovers, and the settings of their index.

    The former are looked for in `sessions`, drives among them in `drives`. Raises DatasetError if one is gone or
    has changed.
    """
    settings, fingerprints = data_of_run(run)
    logs: list[Location] = []
    for name, fingerprint in fingerprints.items():
        drive = drives / f"{name}.mcap"
        is_drive = is_there(drive) and not is_there(sessions / drive.name)
        logs.append(find_unchanged_log(str(drive) if is_drive else name, sessions, fingerprint))
    return [*logs, *takeovers], replace(settings, drives="takeovers")
