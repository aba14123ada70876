"""The check of all pictures of a log: it finds frozen and broken pictures, and steering that contradicts them. It
is read from the index, or this module's process makes it on request."""

from __future__ import annotations

from pathlib import Path

from common.car import CAMERAS
from common.files import session_name
from common.location import absolute
from dataset.frames.frame_flags import ImageFindings
from dataset.frames.image_check_cache import check_images, read_image_check, write_image_check
from recorder import Log
from recorder.topics import camera_topic
from web.errors import WebError
from web.processes.kept_work import KeptWork
from web.processes.own_process import report, run_in_process


class PictureChecks:
    """Checks by a log's fingerprint. One is made at a time, because it uses all processors."""

    def __init__(self, index: Path, cache: Path) -> None:
        self._index = index
        self._kept = cache / "checks"
        self.work = KeptWork(self._kept, "web.logs.picture_checks", "it was stopped")

    def findings(self, log: Log) -> ImageFindings | None:
        """The findings for a log's pictures; None if they were never checked. Findings of earlier versions lack
        the comparison with the steering."""
        indexed = read_image_check(self._index, session_name(log.path), log.fingerprint)
        if indexed is not None and indexed.against is not None:
            return indexed
        return read_image_check(self._kept, log.fingerprint, log.fingerprint) or indexed

    def are_checked(self, log: Log) -> bool:
        """Whether there are findings with the comparison."""
        findings = self.findings(log)
        return findings is not None and findings.against is not None

    def start(self, log: Log) -> None:
        """Start a check, unless it is running."""
        pictures = sum(log.counts.get(camera_topic(camera), 0) for camera in CAMERAS)
        self.work.start(log.fingerprint, pictures, [str(absolute(log.path)), log.fingerprint])


def main() -> None:
    run_in_process(_check)


def _check(path: str, fingerprint: str, result: str) -> None:
    pictures = 0

    def on_decoded(count: int) -> None:
        nonlocal pictures
        pictures += count
        report(pictures=pictures)

    with Log(Path(path)) as log:
        if log.fingerprint != fingerprint:
            raise WebError("the log has been replaced since this page was opened: reload it")
        findings = check_images(log, on_decoded)
    write_image_check(Path(result).parent, fingerprint, fingerprint, findings)
