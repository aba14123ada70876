"""`bc-play`: show logs in the Rerun viewer."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from common import UserError
from common.command import DONE, DONE_BUT_SKIPPED, flags_given, run_command, usage_errors, warn, warn_skipped
from common.errors import UsageError, counted
from common.files import refuse_existing
from common.output import print_message, print_next, print_result
from common.versions import package_line
from viz.config import Play, check_files, check_video_flags, check_viewer_flags

if TYPE_CHECKING:
    from model.evaluation.log_predictions import LogPredictions
    from viz.targets import Destination, FinishedContent, GrowingLogContent


def play(config: Play) -> int:
    check_files(config)
    if config.video is not None:
        check_video_flags(config)
        return _make_video(config, config.video)
    check_viewer_flags(config)
    _prepare_rerun()
    if config.run:
        return _play_predicted(config)
    return _show_or_save(config, _content(config))


def _prepare_rerun() -> None:
    if find_spec("rerun") is None or find_spec("rerun_cli") is None:
        raise UserError(f"the viewer is not installed: install it with `{package_line('rerun-sdk')}`")
    from viz.viewer_process import SENDER_LOG

    os.environ.setdefault("RUST_LOG", SENDER_LOG)  # Rerun reads it when it starts


def _show_or_save(config: Play, content: FinishedContent | GrowingLogContent) -> int:
    if config.save is None:
        code = content.show(_destination(config))
        if code in (DONE, DONE_BUT_SKIPPED) and not config.follow:
            print_next(f"bc-log info {shlex.quote(str(config.log))}")
        return code
    code = content.save(config.save, overwrite=config.force)
    print_result(f"{config.save}: written")
    print_next(f"rerun {shlex.quote(str(config.save))}")
    return code


def _content(config: Play) -> FinishedContent | GrowingLogContent:
    from viz.live.live_log import find_log, is_finished
    from viz.playback.comparison import check_count, prepare_comparison
    from viz.playback.rerun_recording import prepare_log
    from viz.targets import FinishedContent, GrowingLogContent

    if len(config.logs) > 1:
        check_count(config.logs)
        _check_logs(config.logs)
        size = sum(path.stat().st_size for path in config.logs if path.is_file())
        return FinishedContent(lambda: prepare_comparison(config.logs, config.by, config.at), size)
    path = find_log(config.log) if config.follow else config.log
    if config.follow and not is_finished(path):
        return GrowingLogContent(path)
    _check_logs([path])
    return FinishedContent(lambda: prepare_log(path, at_s=config.at), path.stat().st_size if path.is_file() else 0)


def _check_logs(paths: Sequence[Path]) -> None:
    """Raise LogError for an empty log, or a file that is not a log, before a viewer opens. Print a notice about
    missing CRCs."""
    from recorder import Log, LogError
    from recorder.mcap.mcap_file import WITHOUT_CRCS, McapFile
    from recorder.mcap.scan import counts_no_message

    for path in dict.fromkeys(paths):
        empty = LogError(f"{path}: an empty log; `bc-log ls` lists others")
        with McapFile(path) as file:
            if counts_no_message(file):
                raise empty
            if file.promises_crcs:  # for an unfinished log, `has_crcs` would read the whole file
                continue
        with Log(path) as log:
            if not log.chunks and not log.problem:  # its end has no statistics
                raise empty
            if not log.has_crcs:
                print_message(f"{path}: {WITHOUT_CRCS}")


def _destination(config: Play) -> Destination:
    from viz.targets import Destination
    from viz.viewer_process import Ports

    address = None if config.connect is None else "".join(config.connect)
    return Destination(config.web, address, Ports(config.web_port, config.port))


def _make_video(config: Play, video: Path) -> int:
    from viz.video import HELD_S, check_speed, write_video
    from viz.video_overlay import clock

    with usage_errors(UserError):
        check_speed(config.speed)
    _check_logs(config.logs)
    made = write_video(config.log, video, speed=config.speed, overlay=config.overlay, overwrite=config.force)
    size = f"{made.width} x {made.height}"
    print_result(f"{video}: written; {counted(made.pictures, 'picture')}, {size}, {clock(made.duration_s)} long")
    if made.gaps:
        gaps = f"{counted(made.gaps, 'gap')} of more than a second"
        print_message(f"{gaps} shortened to {HELD_S:g} s: {clock(made.cut_s)} of the log in all")
    if made.left_out:
        pictures = counted(made.left_out, "picture")
        print_message(
            f"{pictures} left out, in the same sixtieth of a second as another: a video has at most 60 a second"
        )
    return max(_warn_unfinished(made.notice), warn_skipped(made.skipped))


def _play_predicted(config: Play) -> int:
    """Show a log with predictions of networks, or write the predictions. Returns the exit code."""
    from model import find_run
    from model.evaluation.predict_log import predict_log
    from model.runs.run_folder import load_named
    from viz.playback.predicted_recording import prepare_predictions
    from viz.targets import FinishedContent

    if config.follow:
        raise UsageError("--run: a growing log cannot be predicted: give it without --follow")
    is_only_written = config.write is not None and config.save is None
    if is_only_written and (flags := flags_given(config, "attention", "web", "connect", "at")):
        raise UsageError(f"--write opens nothing: give it without {flags}")
    for path in (config.save, config.write):
        if path is not None:
            refuse_existing(path, config.force)  # before minutes of work
    _check_logs(config.logs)
    runs = [find_run(name, config.runs) for name in config.run]
    load_named(config.network, runs)
    if is_only_written:
        predictions = predict_log(config.log, runs)
        code = max(_report_predictions(config, predictions), _warn_unfinished(predictions.notice))
        print_next(f"bc-play {shlex.quote(str(config.write))}")
        return code
    codes = [DONE]
    whole = FinishedContent(
        lambda: prepare_predictions(
            config.log,
            runs,
            lambda predictions: codes.append(_report_predictions(config, predictions)),
            attention=config.attention,
            at_s=config.at,
        ),
        config.log.stat().st_size * (1 + config.attention * len(runs)) if config.log.is_file() else 0,
    )
    return max(_show_or_save(config, whole), *codes)


def _report_predictions(config: Play, predictions: LogPredictions) -> int:
    from viz.playback.prediction_log import write_predictions

    if config.write is not None:
        write_predictions(predictions, config.write, overwrite=config.force)
        print_result(f"{config.write}: written")
    for run in predictions.predicted:
        print_result(predictions.summary(run))
    return warn_skipped(predictions.skipped)


def _warn_unfinished(notice: str) -> int:
    return warn(notice) if notice else DONE


def main() -> None:
    run_command("bc-play", Play, play)


if __name__ == "__main__":
    main()
