"""The flags of `bc-play`, and the combinations that are refused."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from common import UserError
from common.command import check_port, flags_given
from common.errors import UsageError
from recorder.log_flag import LogFlag


@dataclass(frozen=True)
class Play:
    """Show a log in the Rerun viewer, or compare several.

    Without a display, the viewer is served to browsers on this machine.
    """

    logs: Annotated[tuple[LogFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
    """The log to show, by name or path, or several to compare."""
    at: Annotated[float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: at its start)")] = (
        None
    )
    """Open at this time."""
    by: Literal["time", "place"] = "time"
    """Compare logs by time, or by place along the first one's path."""
    follow: bool = False
    """Show a growing log."""
    save: Path | None = None
    """Write an .rrd file for Rerun; open nothing."""
    connect: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[ADDRESS]")] = None
    """Use a running viewer, at HOST:PORT or PORT; by default Rerun's own."""
    web: bool = False
    """Serve the viewer to browsers on this machine."""
    web_port: int = 9090
    """Port of the page."""
    port: int = 9876
    """Port of the page's data."""
    video: Path | None = None
    """Write an .mp4 of the centre camera; open nothing."""
    speed: float = 1.0
    """Speed of the video, as a multiple of the drive's."""
    overlay: bool = False
    """Draw instruments below the video: wheel, speed, pedals, clock, driver."""
    run: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="RUN")] = ()
    """Show what this run's network would have steered."""
    network: tuple[str, ...] = ()
    """Your network's code: FILE.py:CLASS or MODULE:CLASS."""
    attention: bool = False
    """Show where these networks look (VisualBackProp)."""
    write: Path | None = None
    """Write the predictions to a new log; open nothing."""
    runs: Path = Path("runs")
    """The runs."""
    force: bool = False
    """Replace the file of --save, --video or --write."""

    @property
    def log(self) -> Path:
        return self.logs[0]


def check_files(config: Play) -> None:
    """Raise UserError or UsageError for folders, files that must not be written, and logs given as addresses."""
    if folder := next((log for log in config.logs if log.is_dir()), None):
        raise UserError(f"{folder} is a folder: give a log; `bc-web --open` shows how runs were trained")
    _refuse_unusable_names(config)
    _refuse_logs_as_addresses(config)


def check_video_flags(config: Play) -> None:
    if len(config.logs) != 1:
        raise UsageError("--video shows one log: give one")
    others = ("save", "follow", "web", "connect", "run", "network", "attention", "write", "by", "at")
    if flags := flags_given(config, *others):
        raise UsageError(f"--video writes a file and opens nothing: give it without {flags}")


def check_viewer_flags(config: Play) -> None:
    if not config.run and (flags := flags_given(config, "network", "attention", "write")):
        raise UsageError(f"{flags}: only for networks: give --run NAME as well")
    if flags := flags_given(config, "speed", "overlay"):
        raise UsageError(f"{flags}: only for a video: give --video FILE.mp4 as well")
    if not config.logs:
        raise UsageError("no log is given: bc-play LOG, or bc-play LOG LOG to compare")
    if len(config.logs) > 1 and (flags := flags_given(config, "follow", "run")):
        raise UsageError(f"{flags}: only with one log")
    if len(config.logs) == 1 and config.by != "time":
        raise UsageError("--by place compares several logs: give more than one")
    if config.connect is not None and (config.web or config.save is not None):
        raise UsageError("--connect uses an open viewer: give it without --web, --save")
    if config.at is not None:
        if not 0 <= config.at < math.inf:
            raise UsageError(f"--at {config.at:g}: expected seconds since the log's start, 0 or more")
        if config.follow or config.by != "time":
            raise UsageError("--at is a moment of finished logs, by time: give it without --follow, --by place")
    if config.save is not None and config.web:
        raise UsageError("--save writes a file and opens nothing: give it without --web")
    check_port("--port", config.port)
    check_port("--web-port", config.web_port)


def _refuse_unusable_names(config: Play) -> None:
    """Raise UserError for a file that would replace a log that is read, and UsageError for a name without the
    suffix of its format."""
    files = ("--save", ".rrd", config.save), ("--video", ".mp4", config.video), ("--write", ".mcap", config.write)
    for flag, suffix, path in files:
        if path is None:
            continue
        if path.exists() and any(log.exists() and path.samefile(log) for log in config.logs):
            raise UserError(f"{flag} {path}: is the log itself, which must not change; give another name")
        if path.suffix.lower() != suffix:
            raise UsageError(f"{flag} {path}: it writes an {suffix} file; give a name that ends in {suffix}")


def _refuse_logs_as_addresses(config: Play) -> None:
    """Raise UsageError for logs after --connect, which would take them for addresses."""
    names = config.connect or ()
    if len(names) > 1 or any(map(os.path.lexists, names)):
        raise UsageError("--connect takes one address; put it after the logs: bc-play LOG --connect HOST:PORT")
