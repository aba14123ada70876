"""Find the index that a run was trained on, rebuild it, or add takeovers to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from common.errors import UsageError, first_of
from common.location import Location, absolute
from common.stored_settings import settings_from
from common.untrusted import real_path
from dataset import DatasetError, IndexConfig, Samples, build_index, find_logs
from dataset.frames.frames_file import check_where
from dataset.index.sessions import changed_logs, find_unchanged_log
from model.errors import RunError
from model.runs.provenance import StoredData, is_trained_on
from model.runs.run_arguments import run_argument
from model.runs.run_folder import CONFIG, load_config, run_name
from model.runs.run_inputs import index_of, logs_of


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
