"""The check of all pictures of a log, which decodes them: frozen and broken ones, and steering that contradicts
them. Read from the index, or made here on request."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from common import UserError
from common.errors import printable
from common.location import Location
from dataset.frames.frame_flags import ImageFindings
from dataset.frames.frames_file import session_name
from dataset.frames.image_check_cache import check_images, read_image_check, write_image_check
from recorder import Log
from recorder.log.kept_logs import bring_here
from web.errors import report_bug
from web.folders.cache_folder import CacheFolder


class _StoppedError(Exception):
    """The workbench ends."""


@dataclass
class Checking:
    """A check that was requested."""

    pictures: int = 0  # that were decoded
    is_done: bool = False
    problem: str = ""


class PictureChecks:
    """Checks by a log's fingerprint; one is made at a time, for it uses all processors."""

    def __init__(self, index: Path, cache: CacheFolder) -> None:
        self._index = index
        self._kept = cache.folder / "checks"
        self._pool = ThreadPoolExecutor(1, "checking pictures")
        self._lock = threading.Lock()
        self._checks: dict[str, Checking] = {}
        self._is_stopped = False

    def findings(self, log: Log) -> ImageFindings | None:
        """The findings of a check of a log's pictures; None if they were never checked. Those of earlier versions
        lack the comparison with the steering."""
        of_index = read_image_check(self._index, session_name(log.path), log.fingerprint)
        if of_index is not None and of_index.against is not None:
            return of_index
        return read_image_check(self._kept, log.fingerprint, log.fingerprint) or of_index

    def checking(self, fingerprint: str) -> Checking | None:
        with self._lock:
            return self._checks.get(fingerprint)

    def start(self, path: Location, fingerprint: str) -> None:
        """Begin with a check, if it is not under way."""
        with self._lock:
            known = self._checks.get(fingerprint)
            if known is not None and not known.is_done:
                return
            self._checks[fingerprint] = checking = Checking()
        self._pool.submit(self._check, path, fingerprint, checking)

    def close(self) -> None:
        self._is_stopped = True
        self._pool.shutdown(cancel_futures=True)

    def _check(self, path: Location, fingerprint: str, checking: Checking) -> None:
        def on_decoded(count: int) -> None:
            checking.pictures += count
            if self._is_stopped:
                raise _StoppedError

        try:
            with Log(path) as log:  # of its own: a page may close the other
                bring_here([log])
                found = check_images(log, on_decoded)
            write_image_check(self._kept, fingerprint, fingerprint, found)
        except _StoppedError:
            return
        except (UserError, OSError, MemoryError) as error:
            checking.problem = printable(str(error)) or "not enough memory"
        except Exception as error:
            checking.problem = report_bug(error)
        finally:
            checking.is_done = True
