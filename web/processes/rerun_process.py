"""The process that writes a log as a recording file for Rerun's viewer, and reports notes on it."""

from __future__ import annotations

import os
from pathlib import Path

from common import Skipped
from common.errors import printable
from common.location import location
from recorder.log_copy_cli import brought_here
from viz.live.follow import save_growing
from viz.playback.rerun_recording import prepare_log, save_prepared
from viz.viewer_process import SENDER_LOG
from web.processes.own_process import report, run_in_process


def main() -> None:
    os.environ.setdefault("RUST_LOG", SENDER_LOG)
    run_in_process(_work)


def _work(log: str, rrd: str, kind: str) -> None:
    if kind == "growing":
        followed = save_growing(Path(log), Path(rrd), keeps_up=True)
        _report(followed.notice, *_skipped(followed.skipped))
        return
    with brought_here([location(log)]) as (path,), prepare_log(path) as prepared:
        _report(*prepared.notices)
        save_prepared(prepared, Path(rrd), overwrite=False)
        _report(*_skipped(prepared.skipped))


def _skipped(skipped: Skipped) -> list[str]:
    return [f"skipped {line}" for line in skipped.lines()]


def _report(*notes: str) -> None:
    for note in filter(None, notes):
        report(note=printable(note))
