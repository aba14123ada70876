"""Show a log while it is being written, in a process whose end does not disturb the recording."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import rerun as rr

from common import Skipped, UserError
from common.command import warn
from common.files import final_path
from recorder.mcap.mcap_file import WITHOUT_CRCS
from viz.console import print_error, print_notice, print_skipped
from viz.live.live_log import GrowingLog, LiveMessageSender
from viz.rrd_file import rrd_file
from viz.viewer_connection import POLL_S, ViewerFeed, ViewerGoneError

BEHIND_S: Final = 2.0
"""If sending was delayed by more than this time, pictures older than this time are skipped."""
HISTORY_S: Final = 60.0  # when the viewer opens, pictures older than this time are skipped
VIEWER_MEMORY: Final = "1GB"  # above it, the viewer drops the oldest data
WHOLE_S: Final = 2.0  # time between two updates of the histogram and the path, which show the whole log


@dataclass(frozen=True)
class FollowResult:
    notice: str  # a notice that the recording was killed; empty if it was finished
    skipped: Skipped  # messages and pictures that were not shown


def save_growing(
    path: Path, rrd: Path, *, overwrite: bool = False, stop: threading.Event | None = None, keeps_up: bool = False
) -> FollowResult:
    """Write the growing log at `path` to the file `rrd`, until the log is finished, its recording is killed, or
    `stop` is set. `keeps_up` is for a file that is watched while it grows: see `_send`.

    Raises LogError if the log cannot be read or is deleted before its end; UserError if `rrd` exists and may not
    be overwritten, or if the disk is full.
    """
    _refuse_windows()
    with rrd_file(rrd, overwrite=overwrite) as file, GrowingLog(path) as log:
        file.recording.send_recording_name(final_path(path).name)
        flush = file.recording.flush if keeps_up else None
        _send(log, file.recording, stop or threading.Event(), file.has_failed, flush)
    return FollowResult(log.notice, log.skipped)


class LogFeed(ViewerFeed):
    """Shows a growing log until it is finished. Problems of the log are printed on stderr when they happen."""

    def __init__(self, path: Path, url: str) -> None:
        _refuse_windows()
        super().__init__(url)
        self._path = path

    def run(self) -> None:
        name = final_path(self._path).name
        recording = self._connected(name)
        with GrowingLog(self._path) as log:
            try:
                is_complete = _send(log, recording, self.stop, self.stop, lambda: self._flush(recording))
                if log.notice:
                    self.code = warn(log.notice)
                elif not is_complete:
                    self._raise_if_not_closed()
                elif log.is_finished and not self.stop.is_set():
                    print_notice(f"{name} is finished" + ("" if log.skipped else ", all of it is shown"))
            except UserError as error:
                self.code = print_error(error)
            skipped = print_skipped(log.skipped)
            self.code = self.code or skipped
        self._disconnect(recording)


def _send(
    log: GrowingLog,
    recording: rr.RecordingStream,
    stop: threading.Event,
    has_failed: threading.Event,
    flush: Callable[[], object] | None = None,
) -> bool:
    """Send the growing log until it ends, the viewer is closed, or `stop` is set (then send what is written so
    far). Returns True if everything was sent.

    `flush` waits until a viewer has received all data. With it, the function keeps up with the log: pictures that
    are too old are not sent, but counted in `log.skipped`.
    """
    keep_up = flush is not None
    sender = LiveMessageSender(recording, is_watched=keep_up)
    pictures_of_last_s = HISTORY_S if keep_up else None
    last_s = whole_s = time.monotonic()
    while not has_failed.is_set():
        is_last = stop.is_set()
        for messages in log.read(pictures_of_last_s):
            sender.send(messages)
        is_last = is_last or log.is_finished or bool(log.notice)
        now_s = time.monotonic()
        # A file keeps every version of these drawings and of the layout, but only the last one is seen.
        if is_last or (keep_up and now_s - whole_s >= WHOLE_S):
            sender.finish()
            whole_s = now_s
        try:
            (flush or recording.flush)()  # so that unsent data does not pile up in this process
        except (ViewerGoneError, RuntimeError):
            return False  # the viewer is closed
        if is_last:
            if not log.has_crcs:
                print_notice(f"{final_path(log.path)}: {WITHOUT_CRCS}")
            return True
        stop.wait(POLL_S)
        now_s = time.monotonic()
        pictures_of_last_s = BEHIND_S if keep_up and now_s - last_s > BEHIND_S else None
        last_s = now_s
    return False


def _refuse_windows() -> None:
    if sys.platform == "win32":
        raise UserError("--follow does not work on Windows: Windows cannot rename a file that is open")
