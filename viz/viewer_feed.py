"""Send to a Rerun viewer from a thread, so that a viewer that freezes or dies cannot block the process."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import Final

import rerun as rr

from common import UserError
from common.command import DONE, INTERRUPTED
from common.interrupts import stop_signals
from common.output import clear_live_displays
from viz.console import print_notice
from viz.rrd_file import APPLICATION
from viz.viewer_process import Viewer, end_viewer, wait_until_closed, wait_until_it_listens

POLL_S: Final = 0.1
LAST_DATA_S: Final = 1.5  # for a viewer that was already running to receive the last data

_GRACE_S: Final = 0.5
_FLUSH_S: Final = 0.5  # time limit for the viewer to receive data; then `stop` is checked, and the flush repeated


class ViewerFeed(threading.Thread):
    """A thread that sends content to a viewer: sending to a frozen viewer blocks."""

    def __init__(self, url: str) -> None:
        super().__init__(name="feed", daemon=True)
        self.url = url
        self.stop = threading.Event()
        self.has_unsent = False
        """True while the viewer has not received all data."""
        self.code = DONE

    def _connected(self, name: str) -> rr.RecordingStream:
        """A new recording with this name in the viewer."""
        recording = rr.RecordingStream(APPLICATION)
        recording.connect_grpc(self.url)
        recording.send_recording_name(name)
        return recording

    def _flush(self, recording: rr.RecordingStream) -> None:
        """Wait until the viewer has received all data. Raises ViewerGoneError if the viewer is closed, or `stop`
        is set."""
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
        with contextlib.suppress(RuntimeError):  # the viewer may close before it has received all data
            recording.disconnect()

    def _raise_if_not_closed(self) -> None:
        """Raise UserError if a viewer that receives nothing any more is not closed within `_GRACE_S`."""
        if not self.stop.wait(_GRACE_S):
            raise UserError("the viewer has lost its connection and shows nothing new; open it again")


class ViewerGoneError(Exception):
    """The viewer is closed, or about to be closed."""


def feed_viewer(feed: ViewerFeed, viewer: Viewer | None) -> int:
    """Run `feed` until its viewer is closed. If `viewer` is None, the viewer was already running: run until it has
    received all data. Returns the exit code. Raises UserError if the viewer does not start, or dies."""
    if viewer is None:
        return _feed_running_viewer(feed)
    wait_until_it_listens(viewer, feed.url)
    feed.start()
    try:
        wait_until_closed(viewer)
    finally:
        feed.stop.set()
        feed.join(_GRACE_S)
        # A frozen viewer blocks the thread until the viewer is killed. Python must not end before the thread: a
        # thread that returns from Rerun into an ending interpreter aborts the process.
        end_viewer(viewer)
        feed.join()
    return feed.code


def _feed_running_viewer(feed: ViewerFeed) -> int:
    with stop_signals() as stopped:  # if Ctrl-C raised within join(), Python 3.11 would take the thread for ended
        feed.start()
        while feed.is_alive() and not stopped.is_set():
            feed.join(POLL_S)  # without a timeout, join() would delay Ctrl-C
        if not stopped.is_set():
            return feed.code
        feed.stop.set()
        feed.join(LAST_DATA_S)
    # For a frozen viewer, Rerun would block now or at the end of Python: only ending the process helps.
    if feed.is_alive() or feed.has_unsent:
        clear_live_displays()
        print_notice("stopped; the viewer has not received all data")
        os._exit(INTERRUPTED)
    raise KeyboardInterrupt
