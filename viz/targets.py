"""What bc-play shows, and where: in a window, to browsers, in a viewer that runs already, or into a file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol
from urllib.parse import urlsplit

from common import UserError
from common.command import DONE, warn, warn_skipped
from common.interrupts import stop_signals
from common.output import print_result
from common.preview import has_display
from viz.console import complain, say
from viz.live.follow import VIEWER_MEMORY, Follower, GoneError, feed, follow, save_growing
from viz.playback.rerun_recording import Prepared, save_prepared
from viz.training_curves import follow_training, prepared_training, wait_until_trained
from viz.viewer_connection import check_viewer, set_time, viewer_url
from viz.viewer_process import Ports, Viewer, free_port, open_viewer

_LARGE: Final = 2_000_000_000  # bytes
WINDOW_MEMORY: Final = "1MB"
"""What the server of a window keeps: nobody comes late, and the window has its own copy."""
_ROOM: Final = 300_000_000  # bytes that a server needs for more than the logs, so that it drops nothing


@dataclass(frozen=True)
class Where:
    """Where to show it."""

    web: bool
    connect: str | None  # the address of a viewer; empty: the usual one
    ports: Ports


class Shown(Protocol):
    """What can be shown."""

    def save(self, rrd: Path, *, overwrite: bool) -> int:
        """Write it to a file; the exit code."""

    def show(self, where: Where) -> int:
        """Show it until the viewer is closed, or another's viewer has it; the exit code."""


class Whole:
    """What does not grow: logs, or how a training went."""

    def __init__(self, prepare: Callable[[], AbstractContextManager[Prepared]], size: int = 0) -> None:
        """`size` is that of what is shown, in bytes."""
        self._prepare = prepare
        self._size = size

    def save(self, rrd: Path, *, overwrite: bool) -> int:
        with self._prepare() as prepared:
            save_prepared(prepared, rrd, overwrite=overwrite)
            return told(prepared.notices)

    def show(self, where: Where) -> int:
        # The viewer starts while the logs are read. The server of a page holds all of them: it may be opened late.
        memory_mb = max(1000, int(1.2 * self._size + _ROOM) // 1_000_000)
        if self._size > _LARGE and where.connect is None:
            less = "a file needs less memory: --save FILE.rrd, then `rerun FILE.rrd`"
            say(f"{self._size / 1e9:.1f} GB to show: {less}")
        with opened(where, server_memory=f"{memory_mb}MB") as (url, viewer), self._prepare() as prepared:
            code = told(prepared.notices)
            fed = feed(_Sender(url, prepared), viewer)
            if viewer is None and fed == DONE:
                print_result(f"{prepared.name}: sent to {urlsplit(url).netloc}")
            return max(code, fed)


class GrowingLogShown:
    """A log that is being written."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def save(self, rrd: Path, *, overwrite: bool) -> int:
        with stop_signals() as stopped:  # what is there by then is kept
            followed = save_growing(self._path, rrd, overwrite=overwrite, stop=stopped)
        return max(told([followed.notice]), warn_skipped(followed.skipped))

    def show(self, where: Where) -> int:
        with opened(where, memory=VIEWER_MEMORY, server_memory=VIEWER_MEMORY) as (url, viewer):
            return follow(self._path, url, viewer)


class GrowingTraining:
    """A run that is being trained."""

    def __init__(self, run: Path) -> None:
        self._run = run

    def save(self, rrd: Path, *, overwrite: bool) -> int:
        wait_until_trained(self._run)
        return Whole(lambda: prepared_training(self._run)).save(rrd, overwrite=overwrite)

    def show(self, where: Where) -> int:
        with opened(where, memory=VIEWER_MEMORY, server_memory=VIEWER_MEMORY) as (url, viewer):
            return follow_training(self._run, url, viewer)


@contextlib.contextmanager
def opened(
    where: Where, *, memory: str | None = None, server_memory: str | None = None
) -> Iterator[tuple[str, Viewer | None]]:
    """A viewer: its URL, and its process if it was opened for this. It shows nothing yet.

    Raises UserError if it cannot be opened, or does not listen.
    """
    if where.connect is not None:
        url = viewer_url(where.connect)
        if notice := check_viewer(url):
            say(notice)
        yield url, None
        return
    web = where.web or not has_display()
    # A window gets a port of its own: several may be open beside each other.
    ports = where.ports if web else Ports(where.ports.web, free_port())
    kept = server_memory if web else WINDOW_MEMORY
    with open_viewer(ports, web=web, memory=memory, server_memory=kept) as viewer:
        if web:
            print_result(ports.web_address)
            say("open that address in a browser; Ctrl-C ends")
        yield ports.data_address, viewer


def told(notices: Sequence[str]) -> int:
    """Print what logs that were never finished have to say; the exit code that says so."""
    return max((warn(notice) for notice in notices if notice), default=DONE)


class _Sender(Follower):
    """Sends what does not grow."""

    def __init__(self, url: str, prepared: Prepared) -> None:
        super().__init__(url)
        self._prepared = prepared

    def run(self) -> None:
        recording = self._connected(self._prepared.name)
        if self._prepared.layout is not None:
            recording.send_blueprint(self._prepared.layout)
        try:
            try:
                self._prepared.send(recording, lambda: self._flush(recording))
                if self._prepared.at_s is not None:
                    set_time(self.url, recording, self._prepared.at_s, self.stop)
            except GoneError:
                self._refuse_silence()
                return
        except UserError as error:
            self.code = complain(error)
        self._disconnect(recording)
