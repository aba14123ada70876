"""The process that writes a log as a recording file for Rerun's viewer, and reports notes on it on stdout."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

from common import Skipped, UserError
from common.errors import printable
from common.location import location
from common.output import print_result
from common.parent_process import end_with_parent
from recorder.log_copy_cli import brought_here
from viz.live.follow import save_growing
from viz.playback.rerun_recording import prepare_log, save_prepared
from viz.viewer_process import SENDER_LOG


def main() -> None:
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the web server's threads block those that end a process
    end_with_parent()
    os.environ.setdefault("RUST_LOG", SENDER_LOG)
    log, rrd, kind = sys.argv[1:]
    try:
        if kind == "growing":
            followed = save_growing(Path(log), Path(rrd), keeps_up=True)
            _report(followed.notice, *_skipped(followed.skipped))
            return
        with brought_here([location(log)]) as (here,), prepare_log(here) as prepared:
            _report(*prepared.notices)
            save_prepared(prepared, Path(rrd), overwrite=False)
            _report(*_skipped(prepared.skipped))
    except UserError as error:
        print_result(json.dumps({"problem": printable(str(error))}))


def _skipped(skipped: Skipped) -> list[str]:
    return [f"skipped {line}" for line in skipped.lines()]


def _report(*notes: str) -> None:
    for note in filter(None, notes):
        print_result(json.dumps({"note": printable(note)}))
