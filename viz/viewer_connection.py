"""Connect to a running viewer of the same version, and send to it from a thread, so that a viewer that freezes or
dies cannot block the process."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import threading
from typing import Final
from urllib.parse import urlsplit

import rerun as rr

from common import UserError
from common.command import DONE, INTERRUPTED
from common.errors import UsageError
from common.grpc_probe import speaks_grpc
from common.interrupts import stop_signals
from common.output import clear_live_displays
from viz.console import print_notice
from viz.rrd_file import APPLICATION
from viz.timelines import SINCE_START
from viz.viewer_process import LOCAL, Viewer, end_viewer, wait_until_closed, wait_until_it_listens

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
        self.has_unsent = False  # True while the viewer has not received all data
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


DEFAULT_PORT: Final = 9876  # the default port of Rerun's viewer

_PATIENCE_S: Final = 10.0  # for a slow and busy machine
_POLL_S: Final = 0.1
_PORT: Final = re.compile(r"[1-9]\d{0,4}")
_PLACE: Final = re.compile(r"(?:[\w.-]+|\[[\da-fA-F:]+\]):[1-9]\d{0,4}")


def viewer_url(address: str) -> str:
    """Rerun's URL of a viewer. `address` is "PORT", "HOST:PORT" or a Rerun URL; empty: the default port on this
    machine.

    Raises UsageError for anything else.
    """
    if not address or _PORT.fullmatch(address):
        return f"rerun+http://{LOCAL}:{address or DEFAULT_PORT}/proxy"
    if _PLACE.fullmatch(address):
        return f"rerun+http://{address}/proxy"
    with contextlib.suppress(ValueError):
        url = urlsplit(address)
        if url.scheme == "rerun+http" and url.path == "/proxy" and url.hostname and url.port:
            return address
    raise UsageError(
        f"--connect {address}: expected HOST:PORT, or PORT on this machine, for example {LOCAL}:{DEFAULT_PORT}"
    )


def check_viewer(url: str) -> str:
    """Check that a Rerun viewer of the right version listens at `url`. Returns a notice if the viewer does not
    give its version, else "". Rerun itself would only wait for five seconds.

    Raises UserError if no viewer listens, or if its version differs.
    """
    where = urlsplit(url).netloc
    _refuse_others(url, where)
    needed = f"version {rr.__version__} is needed: open it with `rerun` of bc-play's environment"
    try:
        version = _version(url)
    except (OSError, RuntimeError) as error:  # OSError: ConnectionError or TimeoutError
        if "Unimplemented" not in str(error):
            raise UserError(f"{where}: the viewer does not answer; open another one with `rerun`") from None
        # servers of `rerun --serve-web`, and old viewers
        return f"{where}: its version is unknown; {needed}"
    if version is not None and version.split(".")[:2] != rr.__version__.split(".")[:2]:
        raise UserError(f"{where}: a viewer of version {version}, but {needed}")
    return ""


def set_time(url: str, recording: rr.RecordingStream, at_s: float, stop: threading.Event) -> None:
    """Wait until the viewer at `url` has the data, then pause it at `at_s` seconds after the start. Returns early
    if `stop` is set. A server for browsers cannot be paused: its layout plays in a loop."""
    from rerun.experimental import ViewerClient

    client = ViewerClient.connect(url)
    name = recording.get_recording_id()
    try:
        while not stop.wait(_POLL_S):
            for shown in client.get_state().recordings:
                times = [line.name for line in shown.timelines]
                if name is not None and shown.store_id.endswith(name) and SINCE_START in times:
                    client.set_time(SINCE_START, duration=at_s, play_state="paused", recording=shown.store_id)
                    return
    except (OSError, RuntimeError):  # the viewer has no cursor, or is closed
        return


def _version(url: str) -> str | None:
    from rerun.experimental import ViewerClient

    return ViewerClient.connect(url).get_state().viewer_version


def _refuse_others(url: str, where: str) -> None:
    place = urlsplit(url)
    try:
        connection = socket.create_connection((place.hostname or LOCAL, place.port or DEFAULT_PORT), _PATIENCE_S)
    except (OSError, OverflowError, ValueError):
        raise UserError(f"{where}: no viewer listens; open one with `rerun --port PORT`") from None
    with connection:
        try:
            is_viewer = speaks_grpc(connection)
        except TimeoutError:
            raise UserError(
                f"{where}: no answer: the viewer is frozen, or another program listens on this port"
            ) from None
        except OSError:
            is_viewer = False
    if not is_viewer:
        raise UserError(
            f"{where}: the program on this port is not a Rerun viewer; open one with `rerun --port PORT`"
        )
