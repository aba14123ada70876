"""The process that checks all pictures of a log. It reports progress on stdout, and saves the findings."""

from __future__ import annotations

from pathlib import Path

from common.location import location
from dataset.frames.image_check_cache import check_images, write_image_check
from recorder import Log
from recorder.log.kept_logs import bring_here
from web.errors import WebError
from web.processes.own_process import report, run_in_process


def main() -> None:
    run_in_process(_work)


def _work(path: str, fingerprint: str, result: str) -> None:
    pictures = 0

    def on_decoded(count: int) -> None:
        nonlocal pictures
        pictures += count
        report(pictures=pictures)

    with Log(location(path)) as log:
        if log.fingerprint != fingerprint:
            raise WebError("the log has been replaced since this page was opened: reload it")
        bring_here([log])
        findings = check_images(log, on_decoded)
    write_image_check(Path(result).parent, fingerprint, fingerprint, findings)
