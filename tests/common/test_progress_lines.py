"""Where stderr is no terminal, a bar prints a line now and then; it minds nothing that becomes of stderr."""

from __future__ import annotations

import io
import sys
import threading

import pytest

from common.progress import progress_bar
from tests.helpers.waiting import wait_until


def printers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "progress"]


def test_a_bar_prints_lines_until_stderr_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("common.progress.LINE_EVERY_S", 0.01)
    others = set(printers())
    stderr = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stderr)
    with progress_bar() as bar:
        bar.add_task("driving", total=100, completed=40, note="")
        assert wait_until(lambda: "driving: 40 %" in stderr.getvalue())
        stderr.close()
        wait_until(lambda: not set(printers()) - others)  # and pytest hears of no exception in a thread
