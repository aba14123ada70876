"""A log shown while it is being written, by a process whose end does not disturb the recording."""

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
from viz.live.live_log import GrowingLog
from viz.live.live_messages import LiveMessageSender
from viz.rrd_file import rrd_file
from viz.viewer_feed import POLL_S, ViewerFeed, ViewerGoneError, feed_viewer
from viz.viewer_process import Viewer

BEHIND_S: Final = 2.0
"""Held up for longer than that, pictures older than that are skipped."""
HISTORY_S: Final = 60.0
"""Pictures from before the viewer was opened are skipped if they are older than that."""
VIEWER_MEMORY: Final = "1GB"  # beyond that, it drops the oldest
WHOLE_S: Final = 2.0
"""Time between two updates of the drawings of the whole log: histogram and path."""


@dataclass(frozen=True)
class FollowResult:
    """The outcome of a log that was followed to its end."""

    notice: str
    """Says that its recording was killed; empty if it was finished."""
    skipped: Skipped
    """Messages and pictures that were not shown."""


def save_growing(
    path: Path, rrd: Path, *, overwrite: bool = False, stop: threading.Event | None = None, keeps_up: bool = False
) -> FollowResult:
    """Write the log at `path` to the file `rrd` as it grows, until it is finished, its recording was killed, or
    `stop` is set. `keeps_up` is for a file that is watched while it grows: see `_send`.

    Raises LogError if the log cannot be read or is deleted before its end, UserError if `rrd` exists and may
    not be overwritten, or where the disk is full.
    """
    _refuse_windows()
    with rrd_file(rrd, overwrite=overwrite) as file, GrowingLog(path) as log:
        file.recording.send_recording_name(final_path(path).name)
        flush = file.recording.flush if keeps_up else None
        _send(log, file.recording, stop or threading.Event(), file.has_failed, flush)
    return FollowResult(log.notice, log.skipped)


def follow_log(path: Path, url: str, viewer: Viewer | None) -> int:
    """Show the log at `path` as it grows in the viewer at `url`; return the exit code.

    `viewer` is its process if it was opened for this, and shows the log until it is closed; None for a viewer that
    ran before, which has all when the log is finished. Trouble with the log is printed on stderr when it happens.
    Raises UserError if the viewer does not start, or dies.
    """
    return feed_viewer(LogFeed(path, url), viewer)


class LogFeed(ViewerFeed):
    def __init__(self, path: Path, url: str) -> None:
        _refuse_windows()
        super().__init__(url)
        self._path = path

    def run(self) -> None:
        name = final_path(self._path).name
        recording = self._connected(name)
        with GrowingLog(self._path) as log:
            try:
                taken = _send(log, recording, self.stop, self.stop, lambda: self._flush(recording))
                if log.notice:
                    self.code = warn(log.notice)
                elif not taken:
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
    """Send the log as it grows, until it ends, `stop` is set (after sending what is there) or the viewer is gone.
    Return True if all was taken.

    With `flush`, which waits until a viewer has taken what was sent, it keeps up: pictures that are too old
    are not sent, but counted in `log.skipped`.
    """
    keep_up = flush is not None
    sender = LiveMessageSender(recording)
    pictures_of_last_s = HISTORY_S if keep_up else None
    last_s = whole_s = time.monotonic()
    while not has_failed.is_set():
        is_last = stop.is_set()
        for messages in log.read(pictures_of_last_s):
            sender.send(messages)
        is_last = is_last or log.is_finished or bool(log.notice)
        now_s = time.monotonic()
        # A file is looked at when it is whole, and would keep each of them.
        if is_last or (keep_up and now_s - whole_s >= WHOLE_S):
            sender.finish()
            whole_s = now_s
        try:
            (flush or recording.flush)()  # what the viewer does not take must not pile up here
        except (ViewerGoneError, RuntimeError):
            return False  # the viewer is gone
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
        raise UserError("--follow does not work on Windows: a file that is open there cannot get its final name")
