"""Provenance: the settings of a run, the versions that trained it, its exact training data, and the run from whose
weights it started. Its inputs are found again, or its index is rebuilt.

A run's config.json stores the places of inputs relative to the run's folder, so all can be moved together.
"""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import torch

from common.errors import UsageError, first_of
from common.files import short_path
from common.location import Location, Url, absolute, location
from common.stored_settings import settings_from
from common.untrusted import real_path
from common.versions import TOOLKIT, version_of
from dataset import DatasetError, IndexConfig, Samples, build_index, find_logs
from dataset.config import EARLIER_ALTERATIONS
from dataset.frames.frames_file import check_where, log_place
from dataset.index.sessions import changed_logs, find_unchanged_log
from model.config import TrainConfig
from model.device import Machine
from model.errors import RunError
from model.network.choice import NetworkChoice
from model.runs.network_of_run import stored_targets
from model.runs.run_files import run_argument
from model.runs.run_folder import CONFIG, config_folder, find_run, load_config, run_name, weights_checksum


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


class StoredLog(msgspec.Struct):
    """A log of the index that a run was trained on, as its config.json stores it."""

    fingerprint: str


class StoredData(msgspec.Struct):
    """The index that a run was trained on, as its config.json stores it."""

    settings: dict[str, Any]
    logs: dict[str, StoredLog]


def provenance(
    samples: Samples, config: TrainConfig, network: NetworkChoice, parameters: int, machine: Machine
) -> dict[str, Any]:
    """The part of a run's config.json that is about its training."""
    return {
        "network": network.description,
        "targets": list(config.targets),
        "parameters": parameters,
        "training": asdict(config),
        "machine": {  # its settings that change the last bits of the weights; "training" has the others
            "device": machine.device.type,
            "arithmetic": machine.arithmetic,
            "micro_batch": machine.micro_batch,
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
        },
        "data": {
            "fingerprint": samples.fingerprint,
            "content_fingerprint": samples.content_fingerprint,
            "targets_fingerprint": samples.targets_fingerprint(config.targets),
            **samples.metadata,
        },
        "versions": versions(),
    }


def init_provenance(init: Path, run: Path) -> dict[str, Any]:
    """The weights that `run` starts from, and all data that they were trained on."""
    before = load_config(init)
    earlier = before.get("init")
    data = earlier.get("data") if isinstance(earlier, dict) else None
    return {
        "run": run_name(init),
        "place": relative_place(run, init),
        "weights_sha256": weights_checksum(init),
        "data": [before.get("data"), *(data if isinstance(data, list) else [])],
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that training depends on."""
    return {
        "python": platform.python_version(),
        **{name: version_of(name) for name in (TOOLKIT, "numpy", "pyarrow")},
        "torch": torch.__version__,  # with its build, as +cpu or +cu130, which the package's version may lack
        "opencv": cv2.__version__,
    }


def training_of(stored: dict[str, Any], run: Path) -> TrainConfig:
    """The settings in a run's config. Raises RunError if they cannot be used."""
    settings: Any = stored.get("training")
    match settings:
        case {"alter_each_epoch": ["all"]} if "light" not in settings:  # version 0.3
            settings = {**settings, "alter_each_epoch": list(EARLIER_ALTERATIONS)}
    try:
        return settings_from(TrainConfig, settings)
    except ValueError as error:
        raise RunError(f"{run / CONFIG}: its training settings cannot be used ({error})") from None


def is_trained_on(stored: dict[str, Any], run: Path, samples: Samples) -> bool:
    """True if a run with this config was trained on these samples, even if their logs were rewritten since. Raises
    RunError if the config does not record its samples."""
    try:
        data = stored["data"]
        labels = samples.targets_fingerprint(stored_targets(stored, run))
        if str(data.get("targets_fingerprint", "")) != labels:  # earlier versions: steering only
            return False
        if str(data["fingerprint"]) == samples.fingerprint:
            return True
        # earlier versions did not store the fingerprint of the content
        return str(data.get("content_fingerprint", "")) == samples.content_fingerprint
    except (KeyError, TypeError, AttributeError):
        raise RunError(f"{run / CONFIG}: does not name the data that the run was trained on") from None


def index_of_run(
    run: Path, index: Path, sessions: Path, on_notice: Callable[[str], object] = lambda notice: None
) -> Path:
    """An index of the samples that `run` was trained on: `index` itself, or one that is built from the run's
    settings and logs: next to `index`, or in the current folder if the run itself names `index`. The logs are in
    `sessions`, or where they were during training.

    `on_notice` gets the notices of the build. Raises RunError if a log or its tags have changed since;
    DatasetError if a log is missing; LogError if a log cannot be read.
    """
    stored = load_config(run)
    index, recorded = real_path(index), index_of(run)
    own = index.with_name(f"{index.name}-{run_name(run)}")
    places = [index, own]
    if recorded is not None and index == absolute(recorded):
        # a run from elsewhere may name any folder: nothing is written there
        own = real_path(Path(own.name))
        places = [index, own, real_path(Path("index"))]
    for place in places:
        if _is_of(place, stored, run):
            return place
    settings, fingerprints = _data_of(stored, run)
    before = logs_of(run)
    logs = [
        str(before[name]) if name in before and not (sessions / f"{name}.mcap").is_file() else name
        for name in fingerprints
    ]
    found = find_logs(logs, sessions)
    if changed := changed_logs(found, fingerprints):
        raise RunError(f"{sessions}: {first_of(changed)} changed since {run} was trained on them")
    for notice in build_index(found, own, settings).notices:
        on_notice(notice)
    with Samples(own) as samples:
        if not is_trained_on(stored, run, samples):
            raise RunError(
                f"{own}: the same logs and settings as {run} had, but other samples: the tags of the logs have"
                " changed, the logs were rewritten (`bc-log rewrite`), or another version of the toolkit built the"
                " index"
            )
    return own


def logs_with_takeovers(
    run: Path,
    takeovers: Sequence[Location],
    sessions: Path,
    drives: Path,
    on_notice: Callable[[str], object] = lambda notice: None,
) -> tuple[list[Location], list[Location], IndexConfig]:
    """The logs that `run` was trained on, those of `takeovers` that are not among them, and the settings of the
    index of both.

    The run's logs are looked for in `sessions`, then in `drives`; names of takeovers in `drives`. `on_notice` gets
    a notice of takeovers that were learned before. Raises RunError if all were, or if the config of the run does
    not record its logs; DatasetError if a log is missing or has changed.
    """
    settings, fingerprints = _data_of(load_config(run), run)
    logs: list[Location] = []
    for name, fingerprint in fingerprints.items():
        drive = drives / f"{name}.mcap"
        is_drive = drive.is_file() and not (sessions / drive.name).is_file()
        logs.append(find_unchanged_log(str(drive) if is_drive else name, sessions, fingerprint))
    takeovers = find_logs(takeovers, drives)
    learned = set(map(absolute, logs))
    new = [log for log in takeovers if absolute(log) not in learned]
    if known := [str(log) for log in takeovers if log not in new]:
        line = f"{first_of(known)}: {run} has already learned from {'it' if len(known) == 1 else 'them'}"
        if not new:
            raise RunError(f"{line}; to train longer, give `bc-train resume {run_argument(run)} --epochs N`")
        on_notice(line)
    return logs, new, replace(settings, drives="takeovers")


def _is_of(index: Path, stored: dict[str, Any], run: Path) -> bool:
    """True if the index is readable and holds the samples that a run with this config was trained on."""
    try:
        with Samples(index) as samples:
            return is_trained_on(stored, run, samples)
    except DatasetError:
        return False


def _data_of(stored: dict[str, Any], run: Path) -> tuple[IndexConfig, dict[str, str]]:
    """The settings of the index that a run was trained on, and the fingerprints of its logs by session."""
    try:
        data = msgspec.convert(stored.get("data"), StoredData)
        if any(Path(name).name != name for name in data.logs):
            raise ValueError("a session's name is a path")
        fingerprints = {name: log.fingerprint for name, log in data.logs.items()}
        settings = settings_from(IndexConfig, data.settings)
        if settings.where is not None:
            check_where(settings.where)
        return settings, fingerprints
    except (ValueError, UsageError) as error:
        raise RunError(f"{run / CONFIG}: its index settings cannot be used ({error})") from None
