"""A person at the wheel: the command of a new drive, running drives, and the log and training of an ended one."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from common.errors import printable
from common.files import PART_SUFFIX, final_name, session_name
from common.locks import is_being_written
from common.recipe import Recipe
from common.untrusted import real_path
from recorder import Log, topics
from recorder.bc_pb2 import PilotCommand
from recorder.log.road_places import last_place_m
from recorder.teleop.wheel import OpenWheel, open_wheels
from web.errors import WebError, or_404
from web.folders.project_folders import PLACES, Place, ProjectFolders, key_of
from web.jobs.job_forms import as_argument, form_of, in_one_field
from web.jobs.jobs import Job

TRACKS: Final = ("lake", "mountain", "random", "hairpins")
SEEDED: Final = ("random", "hairpins")
"""Tracks with a seed."""
RATES_HZ: Final = ("5", "10", "20", "25")
"""Rows a second that the form offers."""
EPOCHS_MORE: Final = 4
"""Epochs of learning from takeovers: the network can drive already."""
DEFAULTS: Final[Mapping[str, str]] = {
    **{
        "simulator": "built-in",
        "track": "lake",
        "seed": "1",
        "speed": "10",
        "driver": "me",
        "rate": "10",
        "start": "0",
    },
    **dict.fromkeys(("run", "name", "like", "on"), ""),
}
"""The values of the form. `like` is an earlier drive, such as `sessions/mine`: its settings are the defaults. With
`on`, the new drive begins where that one ended."""

_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,79}")  # also the key of its log in addresses
_SEED: Final = re.compile(r"[0-9]{1,18}")
_MAX_STEM: Final = 70  # a number follows
_NUMBERED: Final = re.compile(r"-[0-9]{1,9}$")


class NewDrive(NamedTuple):
    """The command of a drive, and the folder and key of its log."""

    words: list[str]
    place: Place
    key: str


class EndedDrive(NamedTuple):
    """A drive's log. `is_whole` is False while it is written, and if it was never finished."""

    log: Path
    is_whole: bool
    is_growing: bool


def new_drive(values: Mapping[str, str], folders: ProjectFolders) -> NewDrive:
    """The drive that a form describes. Raises WebError for an invalid name, track or network; the command checks
    the other values."""
    filled = {name: value.strip() for name, value in values.items() if value.strip()}
    earlier = _settings_of(filled["like"], folders, goes_on="on" in filled) if "like" in filled else {}
    settings = {**DEFAULTS, **earlier, **filled}
    name = settings["name"] or free_name(beginning_of(settings["driver"]), folders)
    if not _NAME.fullmatch(name):
        raise WebError("name: expected letters, digits, and . _ -, such as lake-1", 422)
    speed = f"--speed={settings['speed']}"
    built_in = settings["simulator"] == "built-in"
    if settings["driver"] == "me":
        words = ["bc-record", "me", name] if built_in else ["bc-record", "listen", name, "--me"]
        words += [f"--track={_track(settings)}", f"--rate={settings['rate']}"] if built_in else []
        words += _start(settings) if built_in else []
        words += [speed, *folders.flags("sessions")]
        return NewDrive([*words, "--no-page"], "sessions", name)
    run = folders.run_folders().get(settings["run"])
    if run is None:
        raise WebError("run: choose a run; if there is none, train one first", 422)
    words = ["bc-drive", as_argument(run.name), "--takeover=me", speed]
    words += [f"--simulator={_track(settings)}", *_start(settings)] if built_in else []
    words += folders.flags("runs")
    return NewDrive([*words, f"--log={folders.drives / f'{name}.mcap'}", "--no-page"], "drives", name)


def training(place: Place, log: Path, folders: ProjectFolders) -> tuple[list[str], str]:
    """The command that trains a network, and the name of the new run. A session trains a new network. The
    takeovers of a drive train the run that drove. Raises WebError if that run no longer exists, or if a session's
    name looks like a flag."""
    runs = folders.run_folders()
    name = session_name(log)
    if place == "drives":
        with Log(log) as drive:
            name = drive.metadata.get("run", "")
        if key_of(Path(name)) not in runs:
            raise WebError(f"the run {printable(name)!r}, which drove, is not in {folders.runs}", 404)
    begin = name if place == "drives" else f"net-{name}"
    names = itertools.chain([begin], (f"{begin}-{number}" for number in itertools.count(2)))
    run = next(free for free in names if key_of(Path(free)) not in runs)
    if place == "drives":
        values = {"run": name, "takeovers": in_one_field([str(log)]), "name": run, "epochs": str(EPOCHS_MORE)}
        return [*form_of("learn").words(values, folders), f"--recipe={TAKEOVERS_RECIPE}"], run
    return [*form_of("train").words({"name": run}, folders), "--on", as_argument(name)], run


TAKEOVERS_RECIPE: Final[Recipe] = "people"
"""Without altered pictures, as learning from takeovers was measured (docs/studies/at-the-wheel.md)."""


def is_training_on(job: Job, log: Path) -> bool:
    words = job.about.words
    is_on = words[-2:] == ["--on", session_name(log)]
    return is_on or (words[0] == "bc-train" and str(log) in words)  # of --takeovers


def beginning_of(driver: str) -> str:
    """How the names of drives begin that nobody has named: a person's, or a network's."""
    return "test-drive" if driver == "run" else "drive"


def free_name(beginning: str, folders: ProjectFolders, first: int = 1) -> str:
    """A name that no session and no drive has: `beginning` and a number, from `first` on."""
    taken = {key_of(Path(final_name(log.name))) for place in PLACES for log in folders.logs(place).values()}
    names = (f"{beginning}-{number}" for number in itertools.count(first))
    return next(name for name in names if name not in taken)


def running(key: str) -> OpenWheel:
    """The drive of that key. Raises WebError if it does not run (any more)."""
    wheel = next((wheel for wheel in open_wheels(Path.cwd()) if wheel.key == key), None)
    reason = f"no drive {key!r} is running: it has ended, or its process was killed; its recording is kept"
    return or_404(wheel, reason)


def place_of(wheel: OpenWheel, folders: ProjectFolders) -> tuple[Place, str] | None:
    """The project's folder that has a drive's log, and the log's key; None if the log is elsewhere."""
    log = Path(wheel.project, wheel.log)
    for place in PLACES:
        folder: Path = getattr(folders, place)
        if real_path(log.parent) == real_path(folder):
            return place, key_of(Path(final_name(log.name)))
    return None


def ended_drive(place: Place, key: str, folders: ProjectFolders) -> EndedDrive | None:
    """The log of a drive, finished or not; None if there is none."""
    logs = folders.logs(place)
    if key in logs and not logs[key].name.endswith(PART_SUFFIX):
        return EndedDrive(logs[key], is_whole=True, is_growing=False)
    for log in logs.values():
        if key_of(Path(final_name(log.name))) == key:
            return EndedDrive(log, is_whole=False, is_growing=is_being_written(log))
    return None


def takeovers(log: Log) -> list[tuple[int, float]]:
    """The moments when a person took over from the network: the row, and the seconds since the first command."""
    moments: list[tuple[int, float]] = []
    if topics.PILOT_COMMAND not in log.counts:
        return moments
    was_human, first_ns = True, None
    for message, command in log.commands():
        first_ns = message.log_time_ns if first_ns is None else first_ns
        is_human = command.driver == PilotCommand.HUMAN
        if is_human and not was_human:
            moments.append((message.sequence, (message.log_time_ns - first_ns) / 1e9))
        was_human = is_human
    return moments


def _track(settings: Mapping[str, str]) -> str:
    """The name of the track, with its seed; `settings["track"]` may have the seed already."""
    kind, _, own_seed = settings["track"].partition(":")
    seed = own_seed or settings["seed"]
    if kind not in TRACKS or not _SEED.fullmatch(seed) or (own_seed and kind not in SEEDED):
        raise WebError(
            "track: expected lake, mountain, random or hairpins; random and hairpins have a seed from 0 on",
            422,
        )
    return f"{kind}:{seed}" if kind in SEEDED else kind


def _start(settings: Mapping[str, str]) -> list[str]:
    """The flag for the place where a drive begins, if that is not the track's start."""
    return [f"--start={settings['start']}"] if settings["start"] != DEFAULTS["start"] else []


def _settings_of(like: str, folders: ProjectFolders, *, goes_on: bool) -> dict[str, str]:
    """The form's values of an earlier drive, as far as its log has them. With `goes_on`, also the next name, and
    the place where the drive ended."""
    folder, _, key = like.partition("/")
    earlier = next((ended_drive(place, key, folders) for place in PLACES if place == folder), None)
    ended = or_404(earlier, "the drive to continue from no longer exists")
    with Log(ended.log) as log:
        track, rate = log.metadata.get("track", ""), log.metadata.get("drive.rate", "")
        hold_mph = log.read_metadata(topics.PERSON_METADATA).get("hold_mph", "")
        start_m = last_place_m(log) if goes_on else None
        speed = log.metadata.get("set_speed_mph", hold_mph)
    settings = {"simulator": "built-in", "track": track} if track else {"simulator": "any"}
    settings |= {"speed": speed} if speed else {}
    settings |= {"rate": rate} if rate else {}
    settings |= {} if start_m is None else {"start": f"{start_m:.1f}"}
    stem = _NUMBERED.sub("", session_name(ended.log))
    if goes_on and _NAME.fullmatch(stem) and len(stem) < _MAX_STEM:
        settings["name"] = free_name(stem, folders, first=2)
    return settings
