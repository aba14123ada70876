"""A log shown while it is being written: by a process of its own, which may freeze or die and harm nobody."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import rerun as rr

from common import Skipped, UserError
from common.command import DONE, INTERRUPTED, warn
from common.files import final_path
from common.interrupts import stop_signals
from common.output import clear_live_displays
from common.streams import end_process
from recorder.log.mcap_file import WITHOUT_CRCS
from viz.console import print_error, print_notice, print_skipped
from viz.live.live_log import GrowingLog
from viz.live.live_messages import LiveMessageSender
from viz.live.picture_rate import THINNED, PictureRate
from viz.rrd_file import APPLICATION, rrd_file
from viz.viewer_process import Viewer, end_viewer, wait_until_closed, wait_until_it_listens

POLL_S: Final = 0.1
BEHIND_S: Final = 2.0
"""Held up for longer than that, pictures older than that are skipped."""
HISTORY_S: Final = 60.0
"""Pictures from before the viewer was opened are skipped if they are older than that."""
VIEWER_MEMORY: Final = "1GB"  # beyond that, it drops the oldest
WHOLE_S: Final = 2.0
"""Between two times that a viewer gets what is drawn of the whole log: histogram and path."""

_GRACE_S: Final = 0.5
_FLUSH_S: Final = 0.5  # how long a viewer may take until it is asked whether anybody still waits for it
LAST_DATA_S: Final = 1.5  # for another's viewer to take what is on its way


@dataclass(frozen=True)
class FollowResult:
    """What there is to say of a log that was followed to its end."""

    notice: str
    """That its recording was killed; empty if it was finished."""
    skipped: Skipped
    """What could not be shown."""


def save_growing(
    path: Path, rrd: Path, *, overwrite: bool = False, stop: threading.Event | None = None
) -> FollowResult:
    """Write the log at `path` to the file `rrd` as it grows, until it is finished, its recording was killed, or
    `stop` is set.

    Raises LogError if the log cannot be read or is deleted before its end, UserError if `rrd` exists and may
    not be overwritten, or where the disk is full.
    """
    _refuse_windows()
    with rrd_file(rrd, overwrite=overwrite) as file, GrowingLog(path) as log:
        file.recording.send_recording_name(final_path(path).name)
        _send(log, file.recording, stop or threading.Event(), file.has_failed)
    return FollowResult(log.notice, log.skipped)


def follow_log(path: Path, url: str, viewer: Viewer | None) -> int:
    """Show the log at `path` as it grows in the viewer at `url`; the exit code.

    `viewer` is its process if it was opened for this, and shows it until it is closed; with None, it is another's,
    and has all when the log is finished. What goes wrong with the log is told on stderr when it happens. Raises
    UserError if the viewer does not start, or dies.
    """
    return feed_viewer(LogFollower(path, url), viewer)


class Follower(threading.Thread):
    """Sends what is to be shown to a viewer, on a thread: a frozen viewer holds up whoever sends to it."""

    def __init__(self, url: str) -> None:
        super().__init__(name="follower", daemon=True)
        self.url = url
        self.stop = threading.Event()
        self.has_unsent = False
        """Whether something is on its way that the viewer did not take."""
        self.code = DONE

    def _connected(self, name: str) -> rr.RecordingStream:
        """A new recording of this name in the viewer."""
        recording = rr.RecordingStream(APPLICATION)
        recording.connect_grpc(self.url)
        recording.send_recording_name(name)
        return recording

    def _flush(self, recording: rr.RecordingStream) -> None:
        """Wait until the viewer has taken what was sent. Raises ViewerGoneError if it is closed, or will be."""
        while not self.stop.is_set():
            try:
                recording.flush(timeout_sec=_FLUSH_S)
            except RuntimeError as error:
                self.has_unsent = "timed out" in str(error)
                if not self.has_unsent:
                    raise ViewerGoneError from None
            else:
                self.has_unsent = False
                return
        raise ViewerGoneError

    def _disconnect(self, recording: rr.RecordingStream) -> None:
        with contextlib.suppress(RuntimeError):  # the viewer may be gone before its data is
            recording.disconnect()

    def _refuse_silence(self) -> None:
        """Raise UserError unless the viewer, which takes nothing any more, is about to be closed."""
        if not self.stop.wait(_GRACE_S):
            raise UserError("the viewer has lost its connection and shows nothing new; open it again")


class ViewerGoneError(Exception):
    """The viewer is closed, or about to be closed."""


def feed_viewer(follower: Follower, viewer: Viewer | None) -> int:
    """Let `follower` feed an open, empty viewer until that is closed, or all has been sent to another's; the exit
    code. Raises as `follow` does."""
    if viewer is None:
        return _feed_other(follower)
    wait_until_it_listens(viewer, follower.url)
    follower.start()
    try:
        wait_until_closed(viewer)
    finally:
        follower.stop.set()
        follower.join(_GRACE_S)
        # A frozen viewer holds it up until that is killed. Python must not end before the thread has: one that
        # comes back from Rerun into an interpreter that is ending aborts the process.
        end_viewer(viewer)
        follower.join()
    return follower.code


def _feed_other(follower: Follower) -> int:
    """Feed a viewer that somebody else has opened."""
    with stop_signals() as stopped:  # raised within join(), Ctrl-C makes Python 3.11 take the thread for ended
        follower.start()
        while follower.is_alive() and not stopped.is_set():
            follower.join(POLL_S)  # without a time, no Ctrl-C would be heard
        if not stopped.is_set():
            return follower.code
        follower.stop.set()
        follower.join(LAST_DATA_S)
    # Held up by Rerun for a viewer that is frozen, now or when Python ends: nothing else ends it.
    if follower.is_alive() or follower.has_unsent:
        clear_live_displays()
        print_notice("stopped; the viewer has not taken all that was sent to it")
        end_process(INTERRUPTED)
    raise KeyboardInterrupt


class LogFollower(Follower):
    """Sends a log."""

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
                    self._refuse_silence()
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
    """Send the log as it grows, till it is over, `stop` is set (then what is there is sent) or nobody takes it;
    whether all was taken.

    With `flush`, which waits until a viewer has taken what was sent, it keeps up: pictures that are too many or
    too old are not sent, but counted in `log.skipped`.
    """
    keep_up = flush is not None
    sender = LiveMessageSender(recording)
    pictures_of_last_s = HISTORY_S if keep_up else None
    last_s = whole_s = time.monotonic()
    rate: PictureRate | None = None  # of what was there before, all of `HISTORY_S` is shown
    while not has_failed.is_set():
        is_last = stop.is_set()
        for messages in log.read(pictures_of_last_s):
            shown, left_out = rate.thin(messages) if rate is not None else (messages, [])
            for message in left_out:
                log.skipped.add(THINNED, f"{message.topic} row {message.row}")
            sender.send(shown)
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
        if keep_up:
            rate = rate or PictureRate(now_s)
            rate.tick(now_s)
    return False


def _refuse_windows() -> None:
    if sys.platform == "win32":
        raise UserError("--follow does not work on Windows: a file that is open there cannot get its final name")
