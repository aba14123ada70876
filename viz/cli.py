"""`bc-play`: logs, or the training of a run, in the Rerun viewer."""

from __future__ import annotations

import contextlib
import math
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from common import UserError
from common.command import DONE, check_port, flags_given, run_command, usage_errors, warn, warn_skipped
from common.errors import UsageError, counted
from common.files import refuse_existing
from common.output import print_message, print_result

if TYPE_CHECKING:
    from model.evaluation.log_predictions import LogPredictions
    from viz.targets import Content, Destination


@dataclass(frozen=True)
class Play:
    """Open logs in the Rerun viewer: cameras, the network's crop, steering, speed. Several are compared.

    Of a run's folder, it shows how training went: losses, errors beside those of constant predictors, and by bin.
    Without a display, the viewer is served to browsers on this machine.
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
    """The log to open, finished or not, or several to compare, or the folder of a run (runs/NAME)."""
    at: Annotated[float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: at its start)")] = (
        None
    )
    """Open it so many seconds after its start."""
    by: Literal["time", "place"] = "time"
    """Compare logs by time since each one's start, or by place along the way of the first one (needs poses)."""
    follow: bool = False
    """Show a log that is being written, or a run that is being trained, as it grows."""
    save: Path | None = None
    """Write an .rrd file for the Rerun viewer, and open nothing."""
    connect: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[ADDRESS]")] = None
    """Show it in a viewer that runs: at HOST:PORT or PORT; without an address, on Rerun's own port here."""
    web: bool = False
    """Serve the viewer to browsers on this machine, also where there is a display."""
    web_port: int = 9090
    """Port of the page."""
    port: int = 9876
    """Port from which the page gets its data."""
    video: Path | None = None
    """Write the centre camera's pictures as a video, an .mp4, and open nothing."""
    speed: float = 1.0
    """How many times as fast as it was driven the video plays."""
    overlay: bool = False
    """Put a steering wheel, speed, pedals, clock and who drives below the video's pictures."""
    run: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="RUN")] = ()
    """Show what the network of this run would have steered, by name or folder; give it again for another run."""
    attention: bool = False
    """Show where these networks look, over what they see (VisualBackProp)."""
    write: Path | None = None
    """Keep what these networks say as a new log, and open nothing."""
    runs: Path = Path("runs")
    """Where runs are kept, for --run."""
    force: bool = False
    """Replace the file given to --save, --video or --write."""

    @property
    def log(self) -> Path:
        """The only log, or the first of several."""
        return self.logs[0]


def play(config: Play) -> int:
    _refuse_loss(config)
    _refuse_other_endings(config)
    _refuse_swallowed(config)
    if config.video is not None:
        return make_video(config, config.video)
    if not config.run and (flags := flags_given(config, "attention", "write")):
        raise UsageError(f"{flags}: only of networks: give --run NAME as well")
    if flags := flags_given(config, "speed", "overlay"):
        raise UsageError(f"{flags}: only for a video: give --video FILE.mp4 as well")
    _refuse_nonsense(config)
    _prepare_rerun()
    if config.run:
        return _play_predicted(config)
    return _show_or_save(config, _what(config))


def _prepare_rerun() -> None:
    if find_spec("rerun") is None or find_spec("rerun_cli") is None:
        raise UserError("the viewer is not installed here: `pip install rerun-sdk` brings it")
    from viz.viewer_process import SENDER_LOG

    os.environ.setdefault("RUST_LOG", SENDER_LOG)  # read when Rerun starts


def _refuse_nonsense(config: Play) -> None:
    """Raise UsageError for flags that do not go together."""
    if not config.logs:
        raise UsageError("no log is given: bc-play LOG, or bc-play LOG LOG to compare")
    if len(config.logs) > 1 and (flags := flags_given(config, "follow", "run")):
        raise UsageError(f"{flags}: only with one log; several are compared as they are")
    if len(config.logs) == 1 and config.by != "time":
        raise UsageError("--by place compares several logs: give more than one")
    if config.connect is not None and (config.web or config.save is not None):
        raise UsageError("--connect shows it in a viewer that runs: give it without --web, --save")
    if config.at is not None:
        _refuse_no_moment(config)
    if config.save is not None and config.web:
        raise UsageError("--save writes a file and opens nothing: give it without --web")
    check_port("--port", config.port)
    check_port("--web-port", config.web_port)


def _refuse_no_moment(config: Play) -> None:
    """Raise UsageError for an --at that cannot be."""
    if not 0 <= (config.at or 0) < math.inf:
        raise UsageError(f"--at {config.at}: seconds since the log's start, from 0 on")
    if config.follow or config.by != "time":
        raise UsageError("--at is a moment of logs that are shown by time: give it without --follow, --by place")
    if _is_run(config):
        raise UserError(f"--at is a moment of a log, and {config.log} is a folder: give a log, or leave it out")


def _refuse_swallowed(config: Play) -> None:
    """Raise UsageError for logs behind --connect, which takes them for addresses."""
    given = config.connect or ()
    swallowed = [name for name in given if os.path.lexists(name)]
    if len(given) < 2 and (config.logs or not swallowed):
        return
    logs = " ".join(shlex.quote(str(log)) for log in (*config.logs, *swallowed)) or "LOG"
    addresses = [name for name in given if name not in swallowed]
    line = f"bc-play {logs} --connect {' '.join(addresses) if len(addresses) < 2 else 'HOST:PORT'}".rstrip()
    raise UsageError(f"--connect takes one address, and stands behind the logs: {line}")


def _refuse_loss(config: Play) -> None:
    """Raise UserError for a file that would be written over a log that is read, or over another one."""
    flags = (("--save", config.save), ("--video", config.video), ("--write", config.write))
    written = [(flag, path) for flag, path in flags if path is not None]
    for at, (flag, path) in enumerate(written):
        if path.exists() and any(log.exists() and path.samefile(log) for log in config.logs):
            raise UserError(f"{flag} {path}: the log itself, which stays as it is; give another name")
        if any(path.resolve() == other.resolve() for _, other in written[:at]):
            raise UsageError(f"{flag} {path}: two files of one name; give another one")


def _refuse_other_endings(config: Play) -> None:
    """Raise UsageError for a file that nothing would know by its name."""
    for flag, path, ending in (
        ("--save", config.save, ".rrd"),
        ("--video", config.video, ".mp4"),
        ("--write", config.write, ".mcap"),
    ):
        if path is not None and path.suffix.lower() != ending:
            raise UsageError(f"{flag} {path}: it writes an {ending} file; give it such a name")


def _show_or_save(config: Play, shown: Content) -> int:
    """Show it, or write it to a file; the exit code."""
    if config.save is None:
        return shown.show(_where(config))
    code = shown.save(config.save, overwrite=config.force)
    print_result(f"{config.save}: written; open it with `rerun {config.save}`")
    return code


def _what(config: Play) -> Content:
    from viz.live.live_log import find_log, is_finished
    from viz.playback.comparison import prepare_comparison
    from viz.playback.rerun_recording import prepare_log
    from viz.targets import FinishedContent, GrowingLogContent, GrowingTrainingContent
    from viz.training_curves import prepare_training, refuse_no_training

    if len(config.logs) > 1:
        folders = [path for path in config.logs if path.is_dir()]
        if folders:
            raise UserError(f"{folders[0]} is a folder: logs are compared; a run's training is shown alone")
        _look_at(config.logs)
        size = sum(path.stat().st_size for path in config.logs if path.is_file())
        return FinishedContent(lambda: prepare_comparison(config.logs, config.by, config.at), size)
    if _is_run(config):
        refuse_no_training(config.log, is_awaited=config.follow)
        return (
            GrowingTrainingContent(config.log)
            if config.follow
            else FinishedContent(lambda: prepare_training(config.log))
        )
    if not config.log.exists() and (Path("runs") / config.log).is_dir():
        raise UserError(f"{config.log}: no log; to see how a run was trained, `bc-play runs/{config.log}`")
    path = find_log(config.log) if config.follow else config.log
    if config.follow and not is_finished(path):
        return GrowingLogContent(path)
    _look_at([path])
    return FinishedContent(lambda: prepare_log(path, at_s=config.at), path.stat().st_size if path.is_file() else 0)


def _look_at(paths: Sequence[Path]) -> None:
    """Raise LogError for what is no log at all, before a viewer opens to show it; say it of a log without CRCs."""
    from recorder import Log
    from recorder.log.mcap_file import WITHOUT_CRCS, McapFile

    for path in dict.fromkeys(paths):
        with contextlib.closing(McapFile(path)) as file:
            if file.promises_crcs:  # a log that was never finished would be read through for it
                continue
        with Log(path) as log:
            if not log.has_crcs:
                print_message(f"{path}: {WITHOUT_CRCS}")


def _where(config: Play) -> Destination:
    from viz.targets import Destination
    from viz.viewer_process import Ports

    address = None if config.connect is None else "".join(config.connect)
    return Destination(config.web, address, Ports(config.web_port, config.port))


def make_video(config: Play, video: Path) -> int:
    from viz.video import HELD_S, check_speed, write_video
    from viz.video_overlay import clock

    if len(config.logs) != 1:
        raise UsageError("--video is made of one log: give one")
    unfit = flags_given(config, "save", "follow", "web", "connect", "run", "attention", "write", "by", "at")
    if unfit:
        raise UsageError(f"--video writes a file and opens nothing: give it without {unfit}")
    with usage_errors(UserError):
        check_speed(config.speed)
    _look_at(config.logs)
    made = write_video(config.log, video, speed=config.speed, overlay=config.overlay, overwrite=config.force)
    size = f"{made.width} x {made.height}"
    print_result(f"{video}: written; {counted(made.pictures, 'picture')}, {size}, {clock(made.duration_s)} long")
    if made.gaps:
        gaps = f"{counted(made.gaps, 'gap')} of more than a second"
        print_message(f"{gaps} shortened to {HELD_S:g} s: {clock(made.cut_s)} of the log in all")
    if made.left_out:
        pictures = counted(made.left_out, "picture")
        print_message(f"{pictures} left out: a video shows at most 60 a second")
    return max(_told(made.notice), warn_skipped(made.skipped))


def _is_run(config: Play) -> bool:
    """Whether it is a run's folder, or will be: --follow waits for a run, but not for a log."""
    if config.log.is_dir():
        return True
    is_awaited = config.follow and config.save is None and not os.path.lexists(config.log)
    return is_awaited and ".mcap" not in config.log.suffixes


def _play_predicted(config: Play) -> int:
    """A log, and what networks say of it; the exit code."""
    from model import find_run
    from model.evaluation.predict_log import predict_log
    from viz.playback.predicted_recording import prepare_predictions
    from viz.targets import FinishedContent

    if config.log.is_dir():
        raise UserError(f"{config.log} is a folder: --run shows what a network says of a log; give one")
    if config.follow:
        raise UsageError("--run: networks look at a log that does not grow: give it without --follow")
    is_only_written = config.write is not None and config.save is None
    if is_only_written and (flags := flags_given(config, "attention", "web", "connect", "at")):
        raise UsageError(f"--write opens nothing: give it without {flags}")
    for path in (config.save, config.write):
        if path is not None:
            refuse_existing(path, config.force)  # before minutes of work, not after them
    _look_at(config.logs)
    runs = [find_run(name, config.runs) for name in config.run]
    if is_only_written:
        found = predict_log(config.log, runs)
        return max(_tell(config, found), _told(found.notice))
    codes = [DONE]
    whole = FinishedContent(
        lambda: prepare_predictions(
            config.log,
            runs,
            lambda found: codes.append(_tell(config, found)),
            attention=config.attention,
            at_s=config.at,
        ),
        config.log.stat().st_size * (1 + config.attention * len(runs)) if config.log.is_file() else 0,
    )
    return max(_show_or_save(config, whole), *codes)


def _tell(config: Play, found: LogPredictions) -> int:
    """Keep what networks say, if that is wanted, and print it in short; the exit code."""
    from viz.playback.prediction_log import write_predictions

    if config.write is not None:
        write_predictions(found, config.write, overwrite=config.force)
        print_result(f"{config.write}: written; look at it with `bc-play {config.write}`")
    for run in found.predicted:
        print_result(found.summary(run))
    return warn_skipped(found.skipped)


def _told(notice: str) -> int:
    """Print what a log that was never finished has to say; the exit code that says so."""
    return warn(notice) if notice else DONE


def main() -> None:
    run_command("bc-play", Play, play)


if __name__ == "__main__":
    main()
