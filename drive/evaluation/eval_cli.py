"""`bc-eval`: measures a trained network on recorded frames, driving a recording, or driving the simulator."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from common import UserError
from common.command import DONE, flags_given, run_command, usage_errors, warn, warn_skipped
from common.errors import UsageError, counted
from common.output import print_message, print_result

if TYPE_CHECKING:
    from model.evaluation.evaluate import Evaluation


def _default(metavar: str, value: str) -> Any:
    """A flag that is None unless it is given, because it belongs to one way of measuring only."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {value})")


@dataclass(frozen=True)
class Eval:
    """Measure a trained network: on recorded frames that were held out, or driving: a recording, or the simulator.

    bc-eval first
    bc-eval first --session sunday
    bc-eval first --on sunday
    bc-eval first --simulator lake mountain
    """

    run: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """The run, by name or folder; the newest one by default."""
    index: Annotated[Path | None, _default("PATH", "the one that the run was trained on")] = None
    """The index whose frames are measured."""
    split: Annotated[Literal["validation", "train"] | None, _default("{validation,train}", "validation")] = None
    """Which of its frames: those that were held out, or those for training."""
    session: Annotated[tuple[str, ...] | None, _default("SESSION [SESSION ...]", "none")] = None
    """Measure all of these sessions instead, by name, or logs by path; no index is needed."""
    sessions: Annotated[Path | None, _default("PATH", "sessions")] = None
    """Where logs are kept, for --session and --on."""
    worst: Annotated[int | None, _default("INT", "10")] = None
    """How many of the worst frames to list, at most one for each second of a session."""
    on: Annotated[tuple[str, ...] | None, _default("SESSION [SESSION ...]", "none")] = None
    """Let it drive these recordings instead, as fast as they were driven: it sees their pictures, warped to where
    it has steered the car."""
    departure: Annotated[float | None, _default("METRES", "1")] = None
    """Distance from the recorded line from which on the car is put back, which is an intervention."""
    car: Annotated[Literal["auto", "udacity", "built-in"] | None, _default("{auto,udacity,built-in}", "auto")] = (
        None
    )
    """Of which simulator's car a recording is, whose cameras and wheelbase are known; auto asks the log."""
    simulator: Annotated[tuple[str, ...] | None, _default("TRACK [TRACK ...]", "none")] = None
    """Let it drive these tracks instead: lake, mountain, random:SEED; the same run gives the same numbers."""
    laps: Annotated[float | None, _default("FLOAT", "1")] = None
    """How far to drive on each."""
    speed: Annotated[tuple[float, ...] | None, _default("MPH [MPH ...]", "10")] = None
    """Set speeds in mph; every track is driven at each."""
    precision: Annotated[
        Literal["auto", "float32", "bfloat16"] | None, _default("{auto,float32,bfloat16}", "auto")
    ] = None
    """The arithmetic of a network that drives; auto takes what is fastest on this processor, as bc-drive does."""
    logs: Annotated[Path | None, _default("PATH", "drives")] = None
    """Folder for the drives' logs."""
    force: bool = False
    """Replace logs of the same names."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    json: bool = False
    """Print JSON and no table: one object, or with --simulator one a drive."""


RECORDED = "recorded frames"
WAYS = {
    RECORDED: ("index", "split", "session", "sessions", "worst"),
    "--simulator TRACK": ("laps", "speed", "precision", "logs", "force"),
    "--on SESSION": ("sessions", "departure", "car", "precision"),
}
"""The flags that belong to each way of measuring."""


def evaluate(config: Eval) -> int:
    _refuse_contradictions(config)
    if config.on is not None:
        return _drive_recordings(config, config.on)
    return _measure(config) if config.simulator is None else _drive(config, config.simulator)


def _refuse_contradictions(config: Eval) -> None:
    if config.on is not None and config.simulator is not None:
        raise UsageError("--on drives recordings and --simulator tracks: give one or the other")
    way = "--on SESSION" if config.on is not None else RECORDED
    way = "--simulator TRACK" if config.simulator is not None else way
    for other, names in WAYS.items():
        if flags := flags_given(config, *(name for name in names if name not in WAYS[way])):
            raise UsageError(_misplaced(flags, other, way))
    if config.simulator == () or config.speed == ():
        raise UsageError("nothing to drive: give --simulator at least one track, and --speed at least one speed")
    if config.on == ():
        raise UsageError("nothing to drive: give --on at least one session")
    given_once = (("--on", config.on), ("--simulator", config.simulator), ("--speed", config.speed))
    for flag, given in given_once:
        if given is not None and len(set(given)) < len(given):
            raise UsageError(f"{flag} {' '.join(map(str, given))}: give each once")
    if config.session == ():
        raise UsageError("nothing to measure: give --session at least one session")
    if way == RECORDED and config.session is None and config.sessions is not None:
        raise UsageError("--sessions is where the logs of --session and --on are: give one of these too")
    if config.session is not None and (config.index is not None or config.split is not None):
        raise UsageError("--session measures whole sessions, of no index: leave out --index and --split")
    if config.worst is not None and config.worst < 0:
        raise UsageError(f"--worst {config.worst:,}: a number of frames was expected, 0 for none")
    if config.departure is not None and not 0 < config.departure < math.inf:
        raise UsageError(f"--departure {config.departure:g}: a distance above 0 metres was expected")


def _misplaced(flags: str, other: str, way: str) -> str:
    if way == RECORDED:
        return f"{flags}: only with {other}: without it, recorded frames are measured"
    if other == RECORDED:
        return f"{flags}: of recorded frames, and {way.split()[0]} drives: give one or the other"
    return f"{flags}: only with {other}"


def _measure(config: Eval) -> int:
    """Measure on recorded frames."""
    from dataset import find_logs
    from model import find_run
    from model.evaluation.evaluate import evaluate as evaluate_run
    from model.evaluation.evaluate import evaluate_sessions
    from model.worst_moments import worst_frames

    run = find_run(config.run, config.runs)
    split = config.split or "validation"
    if config.session is None:
        index = config.index or _index_of(run)
        found = evaluate_run(run, index, split)
        what: dict[str, Any] = {"index": str(index), "split": split}
    else:
        found = evaluate_sessions(run, find_logs(config.session, config.sessions or Path("sessions")))
        what = {"index": None, "split": None}
    worst = worst_frames(found.frames, 10 if config.worst is None else config.worst)
    if config.json:
        print_result(json.dumps({**what, **found.as_dict(), "worst": [asdict(frame) for frame in worst]}))
    else:
        from drive.evaluation.eval_report import print_evaluation

        print_evaluation(found, worst)
        if config.session is None:
            print_result(f"measured on what {index} {'holds out' if split == 'validation' else 'trains on'}")
    return _print_notices(found, is_training=config.session is None and split == "train")


def _index_of(run: Path) -> Path:
    """The index that the run was trained on; the one in the current folder where a run does not name it."""
    from model.runs.run_inputs import index_of

    index = index_of(run)
    if index is None:
        return Path("index")
    if not index.is_dir():
        raise UserError(
            f"{index}: the index that {run} was trained on is not there any more; give --index INDEX, or measure"
            " whole sessions: --session NAME"
        )
    return index


def _print_notices(found: Evaluation, *, is_training: bool) -> int:
    """Print what a person should know before the numbers are used; the exit code."""
    from model.runs.run_folder import run_name

    code = warn_skipped(found.skipped)
    for notice in found.notices:
        code = warn(notice)
    for remark in found.remarks:
        print_message(remark)
    run, count = run_name(found.run), found.measures.frames
    if found.trained_on is None:
        code = warn(f"{found.run}: does not say what it was trained on; it may have learnt from these frames")
    elif found.trained_on:
        line = f"{run} has learnt from {found.trained_on:,} of these {counted(count, 'frame')}"
        if is_training:
            print_message(f"bc-eval: {line}")
        else:
            code = warn(f"{line}: on others it may be worse; measure frames that its own index holds out")
    return code


def _drive(config: Eval, tracks: tuple[str, ...]) -> int:
    """Let the network drive."""
    from drive.config import DriveConfig
    from drive.errors import DriveError
    from drive.evaluation.closed_loop import evaluate as evaluate_run
    from drive.evaluation.eval_report import print_drives
    from drive.evaluation.simulator_process import BuiltInSimulator, check_laps
    from model import find_run, load_pilot

    laps = 1.0 if config.laps is None else config.laps
    with usage_errors(DriveError):
        check_laps(laps)
        configs = [DriveConfig(set_speed_mph=speed) for speed in config.speed or (10.0,)]
    drives = [
        (BuiltInSimulator(track, laps), each) for each in configs for track in tracks
    ]  # before the seconds that a network takes to load: a track may be misspelt
    pilot = load_pilot(find_run(config.run, config.runs), config.precision or "auto")
    pilot.warm_up()
    results = []
    try:
        for result in evaluate_run(
            pilot,
            drives,
            config.logs or Path("drives"),
            overwrite=config.force,
            notify=lambda text: print_message(f"bc-eval: {text}"),
        ):
            results.append(result)
            if config.json:
                print_result(json.dumps(result.as_dict()))
    finally:  # what was measured is shown, whatever stops the rest
        if results and not config.json:
            print_drives(results)
    return DONE


def _drive_recordings(config: Eval, sessions: tuple[str, ...]) -> int:
    """Let the network drive recordings."""
    from dataset import find_logs
    from model import find_run, load_pilot
    from model.evaluation.recorded_drive import DEPARTURE_M, drive_recording
    from recorder import RecordingError

    logs = find_logs(sessions, config.sessions or Path("sessions"))
    pilot = load_pilot(find_run(config.run, config.runs), config.precision or "auto")
    pilot.warm_up()
    departure_m = DEPARTURE_M if config.departure is None else config.departure
    drives = []
    try:
        for log in logs:
            try:
                drive = drive_recording(pilot.predict, log, departure_m=departure_m, car=config.car or "auto")
            except RecordingError as error:
                raise UserError(f"{error}; if it is of one of these, give --car") from None
            drives.append(drive)
            if config.json:
                print_result(json.dumps({"run": pilot.run, **drive.as_dict()}))
    finally:  # what was measured is shown, whatever stops the rest
        if drives and not config.json:
            from drive.evaluation.eval_report import print_recorded_drives

            print_recorded_drives(pilot.run, drives)
    code = DONE
    for drive in drives:
        code = warn_skipped(drive.skipped) or code
        if drive.notice:
            code = warn(drive.notice)
    return code


def main() -> None:
    run_command("bc-eval", Eval, evaluate)
