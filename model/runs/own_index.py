"""An index that is built for one run: of a few sessions, or of takeovers with what another run was trained on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from common.files import refuse_existing
from common.location import Location
from common.random_access import is_there
from dataset import IndexConfig, build_index
from dataset.index.sessions import find_unchanged_log
from model.runs.reproduce import data_of_run


def build_own_index(
    logs: Sequence[Location], index: Path, settings: IndexConfig, on_notice: Callable[[str], object]
) -> None:
    """Build an index that is not there yet; `on_notice` gets what was left out. Raises UserError if it is there,
    DatasetError if nothing can be learnt from these logs."""
    refuse_existing(index, overwrite=False)
    for notice in build_index(logs, index, settings, leave_out_unreadable=True).notices:
        on_notice(notice)


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
