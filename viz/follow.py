"""A log shown while it is being written: by a process of its own, which may freeze or die and harm nobody."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import rerun as rr
from rich.markup import escape

from common import Skipped, UserError
from common.command import DONE, complain, stderr, warn, warn_skipped
from common.files import final_path
from viz.growing import GrowingLog
from viz.messages import MessageSender
from viz.rrd_file import APPLICATION, rrd_file
from viz.viewer import Ports, end_viewer, wait_until_closed, wait_until_it_listens

POLL_S: Final = 0.2
BEHIND_S: Final = 2.0
"""Held up for longer than that, pictures older than that are skipped."""
HISTORY_S: Final = 60.0
"""Pictures from before the viewer was opened are skipped if they are older than that."""
VIEWER_MEMORY: Final = "1GB"  # beyond that, it drops the oldest

_GRACE_S: Final = 0.5


@dataclass(frozen=True)
class Followed:
    """What there is to say of a log that was followed to its end."""

    notice: str
    """That its recording was killed; empty if it was finished."""
    skipped: Skipped
    """What could not be shown."""


def save_growing(path: Path, rrd: Path, *, overwrite: bool = False) -> Followed:
    """Write the log at `path` to the file `rrd` as it grows, until it is finished or its recording was killed.

    Raises LogError if the log cannot be read or is deleted before its end, UserError if `rrd` exists and may
    not be overwritten, or where the disk is full.
    """
    _refuse_windows()
    with rrd_file(rrd, overwrite=overwrite) as file, GrowingLog(path) as log:
        file.recording.send_recording_name(final_path(path).name)
        _send(log, file.recording, file.has_failed, keep_up=False)
    return Followed(log.notice, log.skipped)


def follow(path: Path, viewer: subprocess.Popen[bytes], ports: Ports) -> int:
    """Show the log at `path` in an open, empty viewer as it grows, until the viewer is closed; the exit code.

    What goes wrong with the log is told on stderr when it happens, and the viewer stays open. Raises UserError
    if the viewer does not start, or dies.
    """
    return feed(_LogFollower(path, ports), viewer, ports)


class Follower(threading.Thread):
    """Sends what grows to a viewer, on a thread: a frozen viewer holds up whoever sends to it."""

    def __init__(self, ports: Ports) -> None:
        super().__init__(name="follower", daemon=True)
        self.stop = threading.Event()
        self.code = DONE
        self._ports = ports

    def _connected(self, name: str) -> rr.RecordingStream:
        """A new recording of this name in the viewer."""
        recording = rr.RecordingStream(APPLICATION)
        recording.connect_grpc(self._ports.data_address)
        recording.send_recording_name(name)
        return recording

    def _refuse_silence(self) -> None:
        """Raise UserError unless the viewer, which takes nothing any more, is about to be closed."""
        if not self.stop.wait(_GRACE_S):
            raise UserError("the viewer has lost its connection and shows nothing new; open it again")


def feed(follower: Follower, viewer: subprocess.Popen[bytes], ports: Ports) -> int:
    """Let `follower` feed an open, empty viewer until that is closed; the exit code. Raises as `follow` does."""
    _refuse_windows()
    wait_until_it_listens(viewer, ports)
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


class _LogFollower(Follower):
    """Sends a log."""

    def __init__(self, path: Path, ports: Ports) -> None:
        super().__init__(ports)
        self._path = path

    def run(self) -> None:
        name = final_path(self._path).name
        recording = self._connected(name)
        with GrowingLog(self._path) as log:
            try:
                _send(log, recording, self.stop, keep_up=True)
                if log.is_finished:
                    stderr().print(f"bc-play: {escape(name)} is finished, all of it is shown")
                elif log.notice:
                    self.code = warn(log.notice)
                else:
                    self._refuse_silence()
            except UserError as error:
                self.code = complain("bc-play", error)
            skipped = warn_skipped(log.skipped)
            self.code = self.code or skipped
        with contextlib.suppress(RuntimeError):  # the viewer may be gone before its data is
            recording.disconnect()


def _send(log: GrowingLog, recording: rr.RecordingStream, stop: threading.Event, *, keep_up: bool) -> None:
    """Send the log as it grows, until it is over, `stop` is set or nobody takes it any more."""
    sender = MessageSender(recording)
    pictures_of_last_s = HISTORY_S if keep_up else None
    last_s = time.monotonic()
    while not stop.is_set():
        for messages in log.read(pictures_of_last_s):
            sender.send(messages)
        try:
            recording.flush()  # what the viewer does not take must not pile up here
        except RuntimeError:
            return  # the viewer is gone
        if log.is_finished or log.notice:
            return
        stop.wait(POLL_S)
        now_s = time.monotonic()
        pictures_of_last_s = BEHIND_S if keep_up and now_s - last_s > BEHIND_S else None
        last_s = now_s


def _refuse_windows() -> None:
    if sys.platform == "win32":
        raise UserError("--follow does not work on Windows: a file that is open there cannot get its final name")
