"""Logs that are open in Rerun. For each, a process of this module writes a recording file, which the viewer in the
page reads.

Rerun's viewer is a WebAssembly program that the `rerun` program serves. bc-web copies it to the cache once.
"""

from __future__ import annotations

import contextlib
import http.client
import os
import secrets
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO, Final

from common import Skipped, UserError
from common.errors import printable
from common.versions import package_line, version_of
from web.errors import WebError, or_404
from web.folders.cache_folder import CacheFolder
from web.processes.kept_work import report, reports, run_in_process, start_process

FILES: Final = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
"""The viewer's files, and their media types."""

_LOCAL: Final = "127.0.0.1"
_PATIENCE_S: Final = 10.0  # for a file of the viewer
_GRACE_S: Final = 3.0  # for a process to end by itself
_POLL_S: Final = 0.05
_BLOCK_BYTES: Final = 1 << 18


class RerunViewer:
    """An open log, and the process that writes its recording."""

    def __init__(self, log: Path, *, is_growing: bool) -> None:
        """Raises WebError if the process cannot be started."""
        self.key = secrets.token_hex(8)
        self.notes: list[str] = []
        """Messages about the log, such as skipped messages."""
        self.problem = ""
        """Why the log is closed; empty while it is open."""
        try:
            self._temporary = tempfile.TemporaryDirectory(prefix="bc-web-", ignore_cleanup_errors=True)
            self._folder = Path(self._temporary.name) / "recording"
            self._folder.mkdir()
            words = [str(log.absolute()), str(self._folder / "log.rrd"), "growing" if is_growing else "finished"]
            self._process = start_process("web.processes.rerun_viewers", words, self._temporary.name)
        except OSError as error:
            raise WebError(f"Rerun cannot be started: {error.strerror}", 500) from None
        self._reader = threading.Thread(target=self._read, name="rerun", daemon=True)
        self._reader.start()

    @property
    def has_begun(self) -> bool:
        file = self._opened()
        if file is None:
            return False
        with file:
            return bool(file.read(1))

    def recording(self) -> Iterator[bytes]:
        """The recording file while it is written, to its end."""
        file = self._opened()
        if file is None:
            return
        with file:
            is_complete = False
            while not self.problem:
                if data := file.read(_BLOCK_BYTES):
                    yield data
                elif is_complete:
                    return
                else:
                    is_complete = self._process.poll() is not None
                    time.sleep(_POLL_S)

    def _opened(self) -> BinaryIO | None:
        for _ in range(2):  # it is renamed when it is complete
            for path in self._folder.glob("*"):
                with contextlib.suppress(FileNotFoundError):
                    return path.open("rb")
        return None

    def close(self) -> None:
        """Wait until the process has ended."""
        assert self._process.stdin is not None  # noqa: S101
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_GRACE_S)
        self._process.kill()
        self._process.wait()
        self._reader.join()
        self._temporary.cleanup()

    def _read(self) -> None:
        for message in reports(self._process):
            self.problem = self.problem or printable(str(message.get("problem", "")))
            if "note" in message:
                self.notes.append(printable(str(message["note"])))
        if code := self._process.wait():
            self.problem = self.problem or f"the process that reads the log ended with {code}; open it again"


class RerunViewers:
    """All open logs. A log is open as long as the request that opened it."""

    def __init__(self, cache: CacheFolder) -> None:
        self._cache = cache
        self._lock = threading.Lock()
        self._fetching = threading.Lock()
        self._open: dict[str, RerunViewer] = {}
        self._closing = ThreadPoolExecutor(thread_name_prefix="rerun ends")

    def open(self, log: Path, *, is_growing: bool) -> RerunViewer:
        """Open a log. Raises WebError if Rerun is not installed or does not start."""
        if find_spec("rerun") is None or find_spec("rerun_cli") is None:
            raise WebError(f"Rerun is not installed here: `{package_line('rerun-sdk')}` brings it", 501)
        viewer = RerunViewer(log, is_growing=is_growing)
        with self._lock:
            self._open[viewer.key] = viewer
        return viewer

    def get(self, key: str) -> RerunViewer:
        with self._lock:
            viewer = self._open.get(key)
        return or_404(viewer, "this log is no longer open in Rerun: open it again from its page")

    def end(self, viewer: RerunViewer) -> None:
        with self._lock:
            if self._open.pop(viewer.key, None) is not None:
                viewer.problem = viewer.problem or "Rerun has ended; open it again"
                self._closing.submit(viewer.close)

    def file(self, name: str) -> bytes:
        """One of the viewer's `FILES`. Raises WebError if Rerun does not serve it."""
        with self._fetching:
            if (kept := self._cache.find(_key(name))) is None:
                try:
                    files = _files_of_viewer()
                except (OSError, UserError, http.client.HTTPException) as error:
                    raise WebError(f"{name}: Rerun does not start ({error}); open the log again", 503) from None
                for file, data in files.items():
                    self._cache.keep(_key(file), data)
                kept = files[name]
        return kept

    def close(self) -> None:
        """Close all logs, and wait until their processes have ended."""
        with self._lock:
            viewers = list(self._open.values())
        for viewer in viewers:
            self.end(viewer)
        self._closing.shutdown()


def viewer_version() -> str:
    """The version of Rerun. The addresses of the viewer's files name it."""
    return version_of("rerun-sdk")


def _key(name: str) -> str:
    return f"rerun {viewer_version()} {name}"


def _files_of_viewer() -> dict[str, bytes]:
    """Fetch the files from a `rerun` that serves them for a moment."""
    from viz.viewer_process import Ports, free_port, open_viewer, wait_until_it_listens

    ports = Ports(free_port(), free_port())
    files = {}
    with open_viewer(ports, web=True) as viewer:
        for port in (ports.data, ports.web):
            wait_until_it_listens(viewer, f"http://{_LOCAL}:{port}")
        for name in FILES:
            connection = http.client.HTTPConnection(_LOCAL, ports.web, timeout=_PATIENCE_S)
            with contextlib.closing(connection):
                connection.request("GET", f"/{name}")
                answer = connection.getresponse()
                if answer.status != 200:
                    raise http.client.HTTPException(f"{name}: HTTP {answer.status}")
                files[name] = answer.read()
    return files


def main() -> None:
    run_in_process(_work)


def _work(log: str, rrd: str, kind: str) -> None:
    from viz.live.follow import save_growing  # these load Rerun
    from viz.playback.rerun_recording import prepare_log, save_prepared
    from viz.viewer_process import SENDER_LOG

    os.environ.setdefault("RUST_LOG", SENDER_LOG)
    if kind == "growing":
        followed = save_growing(Path(log), Path(rrd), keeps_up=True)
        _report(followed.notice, *_skipped(followed.skipped))
        return
    with prepare_log(Path(log)) as prepared:
        _report(*prepared.notices)
        save_prepared(prepared, Path(rrd), overwrite=False)
        _report(*_skipped(prepared.skipped))


def _skipped(skipped: Skipped) -> list[str]:
    return [f"skipped {line}" for line in skipped.lines()]


def _report(*notes: str) -> None:
    for note in filter(None, notes):
        report(note=printable(note))
