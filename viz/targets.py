"""The content that bc-play shows, and its destination: a window, browsers, a running viewer, or a file."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from common import UserError
from common.command import DONE, DONE_BUT_SKIPPED, warn, warn_skipped
from common.interrupts import stop_signals
from common.output import print_result
from common.preview import has_display
from viz.console import print_error, print_notice, print_skipped
from viz.live.follow import VIEWER_MEMORY, LogFeed, save_growing
from viz.playback.rerun_recording import PreparedRecording, save_prepared
from viz.viewer_connection import ViewerFeed, ViewerGoneError, check_viewer, feed_viewer, set_time, viewer_url
from viz.viewer_process import Ports, Viewer, free_port, open_viewer

_LARGE: Final = 2_000_000_000  # bytes
_SENT: Final = 900_000_000  # bytes to send of larger content: the curves of two hours need as much again
WINDOW_MEMORY: Final = "1MB"
"""Memory of a window's server: no viewer connects late, and the window has its own copy."""
_ROOM: Final = 300_000_000  # bytes that a server needs in addition to the logs, so that it drops nothing


@dataclass(frozen=True)
class Destination:
    """A viewer: in a window, for browsers, or already running."""

    web: bool
    connect: str | None  # the address of a running viewer; empty: the default address; None: open a viewer
    ports: Ports


class FinishedContent:
    """Logs that do not grow. `save` writes them to a file. `show` shows them until the viewer is closed; with a
    viewer that was already running, it returns when all is sent. Both return the exit code."""

    def __init__(self, prepare: Callable[[], AbstractContextManager[PreparedRecording]], size: int = 0) -> None:
        self._prepare = prepare
        self._size = size

    def save(self, rrd: Path, *, overwrite: bool) -> int:
        with self._prepare() as prepared:
            save_prepared(prepared, rrd, overwrite=overwrite)
            return max(warn_all(prepared.notices), print_skipped(prepared.skipped))

    def show(self, destination: Destination) -> int:
        # The viewer starts while the logs are read. A page may be opened late, so its server holds all the data.
        every = 1 if self._size <= _LARGE else math.ceil(self._size / _SENT)
        memory_mb = max(1000, int(1.2 * self._size / every + _ROOM) // 1_000_000)
        if every > 1:
            part = f"one picture of {every} is sent, so that 2 GB of memory suffice"
            print_notice(
                f"{self._size / 1e9:.1f} GB to show: {part}; to see all: --save FILE.rrd, then `rerun FILE.rrd`"
            )
        with (
            open_destination(destination, server_memory=f"{memory_mb}MB") as (url, viewer),
            self._prepare() as prepared,
        ):
            notice_code = warn_all(prepared.notices)
            code = feed_viewer(_ContentFeed(url, prepared, every), viewer)
            if viewer is None and code in (DONE, DONE_BUT_SKIPPED):
                print_result(f"{prepared.name}: sent to {urlsplit(url).netloc}")
            return max(notice_code, code)


class GrowingLogContent:
    """A log that is being written, with the methods of `FinishedContent`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def save(self, rrd: Path, *, overwrite: bool) -> int:
        with stop_signals() as stopped:  # Ctrl-C keeps what is written so far
            followed = save_growing(self._path, rrd, overwrite=overwrite, stop=stopped)
        return max(warn_all([followed.notice]), warn_skipped(followed.skipped))

    def show(self, destination: Destination) -> int:
        with open_destination(destination, memory=VIEWER_MEMORY, server_memory=VIEWER_MEMORY) as (url, viewer):
            return feed_viewer(LogFeed(self._path, url), viewer)


@contextlib.contextmanager
def open_destination(
    destination: Destination, *, memory: str | None = None, server_memory: str | None = None
) -> Iterator[tuple[str, Viewer | None]]:
    """Open an empty viewer. Yields its URL, and its process, or None for a viewer that was already running.

    Raises UserError if it cannot be opened, or does not listen.
    """
    if destination.connect is not None:
        url = viewer_url(destination.connect)
        if notice := check_viewer(url):
            print_notice(notice)
        yield url, None
        return
    web = destination.web or not has_display()
    # A window gets its own free port, because several windows may be open.
    ports = destination.ports if web else Ports(destination.ports.web, free_port())
    server_memory = server_memory if web else WINDOW_MEMORY
    with open_viewer(ports, web=web, memory=memory, server_memory=server_memory) as viewer:
        if web:
            print_result(ports.web_address)
            print_notice("open that address in a browser; Ctrl-C ends")
            print_notice("other users of this machine can open it; Rerun in a page of `bc-web` is yours alone")
        yield ports.data_address, viewer


def warn_all(notices: Sequence[str]) -> int:
    return max((warn(notice) for notice in notices if notice), default=DONE)


class _ContentFeed(ViewerFeed):
    def __init__(self, url: str, prepared: PreparedRecording, every: int) -> None:
        super().__init__(url)
        self._prepared = prepared
        self._every = every

    def run(self) -> None:
        recording = self._connected(self._prepared.name)
        recording.send_blueprint(self._prepared.layout)
        try:
            try:
                self._prepared.send(recording, lambda: self._flush(recording), self._every)
                if self._prepared.at_s is not None:
                    set_time(self.url, recording, self._prepared.at_s, self.stop)
            except ViewerGoneError:
                self._raise_if_not_closed()
                return
        except UserError as error:
            self.code = print_error(error)
        finally:
            skipped = print_skipped(self._prepared.skipped)
            self.code = self.code or skipped
        self._disconnect(recording)
