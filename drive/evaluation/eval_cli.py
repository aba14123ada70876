"""`bc-eval`: measure a trained network on recorded frames, or in the simulator."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from common import UserError
from common.command import DONE, DONE_BUT_SKIPPED, FAILED, usage_errors, warn, warn_skipped
from common.errors import UsageError, counted
from common.output import print_message, print_next, print_result
from common.progress import progress_bar, track
from common.ray_flag import tasks_of
from common.tasks import in_processes, one_by_one
from common.untrusted import real_path
from common.verbs import Verb, run_verbs
from drive.evaluation.eval_flags import EARLIER, DriveFlags, Eval, EvalCompare, EvalDrive, FrameFlags

if TYPE_CHECKING:
    from drive.evaluation.closed_loop import DriveResult, PlannedDrive
    from model.evaluation.differences import Verdict
    from model.evaluation.evaluate import Evaluation


def _find_runs(config: Eval | EvalDrive | EvalCompare, *names: str | None) -> list[Path]:
    from model import find_run
    from model.runs.run_folder import load_named

    runs = [find_run(name, config.runs) for name in names]
    load_named(config.network, runs)
    return runs


def measure(config: Eval) -> int:
    from drive.driven_car import keep
    from model.runs.worst_pictures import worst_frames

    (run,) = _find_runs(config, config.run)
    measured_on, (evaluation,) = _evaluations(config.frames, [run])
    code = keep(run, "frames", {**measured_on, **evaluation.as_dict()})
    worst_count = 10 * config.json if config.worst is None else config.worst
    worst = worst_frames(evaluation.frames, worst_count, evaluation.max_deg)
    if config.json:
        print_result(
            json.dumps({**measured_on, **evaluation.as_dict(), "worst": [asdict(frame) for frame in worst]})
        )
    else:
        from drive.evaluation.eval_report import print_evaluation

        print_evaluation(evaluation, worst, bins=config.bins)
        _print_measured_on(measured_on)
    code = max(code, _print_notices(evaluation, measured_on))
    if not config.json:
        _print_verdict(run, evaluation)
    return code


def _evaluations(frames: FrameFlags, runs: Sequence[Path]) -> tuple[dict[str, str | None], list[Evaluation]]:
    """The measured index and split (None for whole sessions), and the runs' predictions. Without --index, it is
    the index of the first run."""
    from dataset import find_logs
    from model.evaluation.evaluate import evaluate_runs, evaluate_runs_on_sessions

    if frames.session:
        logs = find_logs(frames.session, frames.sessions)
        return {"index": None, "split": None}, evaluate_runs_on_sessions(runs, logs)
    index = frames.index or _index_of(runs[0])
    return {"index": str(index), "split": frames.split}, evaluate_runs(runs, index, frames.split)


def _print_measured_on(measured_on: dict[str, str | None]) -> None:
    if measured_on["index"] is not None:
        frames = "frames held out" if measured_on["split"] == "validation" else "frames for training"
        print_result(f"measured on the {frames} of {measured_on['index']}")


def _index_of(run: Path) -> Path:
    """The index that the run was trained on; if the run does not name it, index/ in the current folder."""
    from model.runs.provenance import index_of, local_index_of

    index = index_of(run)
    if index is None:
        return Path("index")
    if isinstance(index, Path) and not index.is_dir():
        raise UserError(
            f"{index}: the index that {run} was trained on is missing; give --index INDEX, or measure"
            " whole sessions: --session NAME"
        )
    return local_index_of(run) or Path("index")


def _print_notices(evaluation: Evaluation, measured_on: dict[str, str | None]) -> int:
    code = warn_skipped(evaluation.skipped)
    for notice in evaluation.notices:
        code = warn(notice)
    for remark in evaluation.remarks:
        print_message(remark)
    return max(code, _print_learnt(evaluation, measured_on))


def _print_learnt(evaluation: Evaluation, measured_on: dict[str, str | None]) -> int:
    """Print a line if the run has, or may have, learnt from the measured frames. Returns the exit code."""
    from model.runs.run_folder import run_name

    run, count = run_name(evaluation.run), evaluation.measures.frames
    if evaluation.trained_on is None:
        return warn(f"{evaluation.run}: does not record its training data; it may have learnt from these frames")
    elif evaluation.trained_on:
        line = f"{run} has learnt from {evaluation.trained_on:,} of these {counted(count, 'frame')}"
        if measured_on["split"] != "train":
            return warn(f"{line}: on other frames it may be worse; measure frames that its own index holds out")
        print_message(f"bc-eval: {line}")
    return DONE


def compare(config: EvalCompare) -> int:
    """Compare two runs. Returns exit code 3 if there is no verdict, and with --gate 1 if B is worse."""
    from model.runs.run_folder import run_name

    a, b = _find_runs(config, config.a, config.b)
    names = run_name(a), run_name(b)
    if real_path(a) == real_path(b):
        warn(f"{names[0]}: A and B are the same run, which is never worse than itself; give another run as B")
    compare_runs = _compare_by_driving if config.tracks else _compare_on_frames
    verdict, code = compare_runs(config, a, b, names)
    if config.gate and verdict == "worse":
        return FAILED
    return DONE_BUT_SKIPPED if verdict == "unknown" else code


def _compare_on_frames(config: EvalCompare, a: Path, b: Path, names: tuple[str, str]) -> tuple[Verdict, int]:
    from model.evaluation.differences import overall
    from model.evaluation.run_comparison import Comparison
    from model.runs.run_files import run_argument

    measured_on, (evaluation_a, evaluation_b) = _evaluations(config.frames, [a, b])
    comparison = Comparison(evaluation_a.driving, evaluation_b.driving, config.tolerance or 0.0)
    if config.json:
        print_result(json.dumps({**measured_on, **comparison.as_dict()}))
    else:
        from drive.evaluation.eval_report import print_comparison

        print_comparison(comparison, names)
        _print_measured_on(measured_on)
        if evaluation_a.without_crashes is not None:
            print_result(f"compared without {counted(evaluation_a.crashes, 'frame')} of crashes and manoeuvres")
    learnt_code = DONE if a == b else _print_learnt(evaluation_b, measured_on)
    code = max(_print_notices(evaluation_a, measured_on), learnt_code)
    if not config.json:
        runs = f"{run_argument(a)} {run_argument(b)}"
        print_next(f"bc-eval compare {runs} --tracks lake", "what errors on frames mean for driving")
    return overall(comparison.differences), code


def _compare_by_driving(config: EvalCompare, a: Path, b: Path, names: tuple[str, str]) -> tuple[Verdict, int]:
    from drive.evaluation.drive_comparison import TOLERANCE, DriveComparison
    from drive.evaluation.eval_report import print_drive_comparison

    drives, logs = _drives(config.tracks, config.driving), config.driving.drives
    results = dict(_driven(config, [(a, logs / "a"), (b, logs / "b")], drives))
    drives_a, drives_b = ([results[first + n] for n in range(len(drives))] for first in (0, len(drives)))
    tolerance = TOLERANCE if config.tolerance is None else config.tolerance
    comparison = DriveComparison(*names, drives_a, drives_b, tolerance)
    if config.json:
        print_result(json.dumps(comparison.as_dict()))
    else:
        print_drive_comparison(comparison, names)
        print_next(f"bc-play {shlex.join(str(drives[0].log) for drives in (drives_a, drives_b))} --by place")
    return comparison.verdict, DONE


def drive(config: EvalDrive) -> int:
    from drive.driven_car import keep
    from drive.evaluation.eval_report import print_drives

    # before the seconds that a network takes to load: a track may be misspelt
    drives = _drives(config.tracks, config.driving)
    results: dict[int, DriveResult] = {}
    codes = [DONE]
    try:
        (run,) = _find_runs(config, config.run)
        for number, result in _driven(config, [(run, config.driving.drives)], drives):
            results[number] = result
            codes.append(keep(run, "simulator", result.as_dict()))
            if config.json:
                print_result(json.dumps(result.as_dict()))
    finally:  # show the measured drives even if an error or Ctrl-C stops the others
        if results and not config.json:
            print_drives([results[number] for number in sorted(results)])
    if not config.json:
        _print_verdict(run)
    return max(codes)


def _print_verdict(run: Path, evaluation: Evaluation | None = None) -> None:
    """Print the verdict on a run: from the errors of `evaluation`, by default from those in the run's folder."""
    from model import judge

    try:
        if evaluation is None:
            verdict = judge(run)
        else:
            sessions = [*evaluation.driving.sessions] if evaluation.trained_on == 0 else ()
            verdict = judge(run, evaluation.driving.measures, sessions, evaluation.hands)
            if evaluation.without_crashes is not None:
                print_result(
                    f"the verdict is without {counted(evaluation.crashes, 'frame')} of crashes and manoeuvres"
                )
        print_result(*verdict.lines)
    except UserError as error:  # the measurement itself is already printed
        warn(str(error))


def _drives(tracks: Sequence[str], driving: DriveFlags) -> list[PlannedDrive]:
    from drive.config import DriveConfig, DriveError
    from drive.evaluation.closed_loop import BuiltInSimulator, check_laps

    for flag, values in (("--tracks", tracks), ("--speed", driving.speed)):
        if len(set(values)) < len(values):
            raise UsageError(f"{flag} {' '.join(map(str, values))}: give each once")
    with usage_errors(DriveError):
        check_laps(driving.laps)
        configs = [DriveConfig(set_speed_mph=speed) for speed in driving.speed]
    return [(BuiltInSimulator(track, driving.laps), settings) for settings in configs for track in tracks]


def _driven(
    config: EvalDrive | EvalCompare, runs: Sequence[tuple[Path, Path]], drives: Sequence[PlannedDrive]
) -> Iterator[tuple[int, DriveResult]]:
    """Make the drives of runs, each given with the folder of its logs. Yields number and result when finished."""
    from drive.driven_car import other_steering
    from drive.evaluation.closed_loop import drive_runs

    driving = config.driving
    for run, _ in runs:
        if line := other_steering(run, None):
            print_message(f"bc-eval: {line}")
    count = len(runs) * len(drives)
    drive = partial(
        drive_runs,
        runs,
        drives,
        networks=config.network,
        precision=driving.precision,
        device=driving.device,
        overwrite=driving.force,
    )
    if driving.ray is not None:
        with tasks_of(driving.ray, gpus=int(driving.device == "cuda")) as tasks:
            yield from track(drive(tasks), "driving", count)
    elif count == 1:
        yield from drive(one_by_one, shows_progress=True)
    else:
        print_message(f"bc-eval: {count} drives, as many at the same time as there are cores")
        with progress_bar() as bar:
            task = bar.add_task(f"{count} drives", total=100 * count, note="")
            yield from drive(
                partial(in_processes, progress=lambda done: bar.update(task, completed=round(100 * done)))
            )


def main() -> None:
    verbs = {"drive": Verb(EvalDrive, drive), "compare": Verb(EvalCompare, compare)}
    run_verbs("bc-eval", Verb(Eval, measure), verbs, EARLIER)
