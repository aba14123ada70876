"""The places of a run's inputs: its index, its logs, and the run whose weights it started from.

A run's config.json stores them relative to the run's folder, so all can be moved together.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from common.errors import UsageError
from common.files import short_path
from common.location import Location, Url, location
from common.untrusted import real_path
from dataset.errors import DatasetError
from dataset.frames.frames_file import log_place
from model.errors import RunError
from model.runs.run_arguments import run_argument
from model.runs.run_folder import CONFIG, config_folder, find_run, load_config, weights_checksum


def relative_place(run: Path, place: Path) -> str:
    """A place as a run's config stores it: relative to the run's folder."""
    run, place = real_path(run), real_path(place)
    try:
        return Path(os.path.relpath(place, run)).as_posix()
    except ValueError:  # on another drive of Windows
        return place.as_posix()


def index_of(run: Path) -> Location | None:
    """The place of the index that a run was trained on, which may not exist any more; None if the config does not
    record it, as in earlier versions, which also trained on indexes in stores."""
    return _place_of(run, load_config(run).get("index"))


def local_index_of(run: Path) -> Path | None:
    """The index that a run was trained on; None if the config does not record it. Raises RunError if it is in a
    store, as indexes of earlier versions may be."""
    index = index_of(run)
    if isinstance(index, Url):
        raise RunError(
            f"{run / CONFIG}: its index {index} is in a store; bring it here first: `bc-copy {index} index`, and"
            " give --index index"
        )
    return index


def logs_of(run: Path) -> dict[str, Location]:
    """The places of the logs of a run's index, by session; empty if the config does not record them."""
    stored, index = load_config(run), index_of(run)
    try:
        logs = {str(name): str(log["log"]) for name, log in stored["data"]["logs"].items()}
    except (KeyError, TypeError, AttributeError):
        return {}
    if not isinstance(index, Path):
        return {}
    with contextlib.suppress(DatasetError):  # not trusted
        places = {name: log_place(log, index) for name, log in logs.items()}
        return {name: short_path(log) if isinstance(log, Path) else log for name, log in places.items()}
    return {}


def sessions_of(run: Path) -> Path | None:
    """The folder with all logs of a run's index. None if the logs are in several folders or in a store, or if the
    folder does not exist any more."""
    folders: set[Location] = {log.parent for log in logs_of(run).values()}
    if len(folders) != 1:
        return None
    folder = folders.pop()
    return folder if isinstance(folder, Path) and folder.is_dir() else None


def init_of(run: Path, runs: Path) -> Path | None:
    """The run whose weights `run` was started from, at its recorded place or by its name in `runs`; None if `run`
    began with random weights.

    Raises RunError if the earlier run is missing, or if its weights have changed.
    """
    stored = load_config(run).get("init")
    if stored is None:
        return None
    try:
        name, weights_sha256 = str(stored["run"]), str(stored["weights_sha256"])
        place = _place_of(run, stored.get("place"))
        if Path(name).name != name:
            raise ValueError("a run's name is a path")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RunError(f"{run / CONFIG}: does not name the run that it was started from ({error})") from None
    is_there = isinstance(place, Path) and place.exists()
    init = find_run(str(place) if is_there else name, runs)
    if weights_checksum(init) != weights_sha256:
        raise RunError(
            f"{init}: its weights have changed since {run} was started from them;"
            f" `bc-train continue {run_argument(init)}` starts from the new ones"
        )
    return init


def _place_of(run: Path, stored: object) -> Location | None:
    if not isinstance(stored, str) or not stored or "\0" in stored:
        return None
    if "://" in stored:
        with contextlib.suppress(UsageError):  # not trusted
            return location(stored)
        return None
    return short_path(real_path(config_folder(run)) / stored)
