"""bc-web with no more than its own packages: what its pages start reads logs of this machine without obstore."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.logs import write_log
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served


@pytest.fixture(autouse=True)
def _without_obstore(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the processes that this one starts."""
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / "sitecustomize.py").write_text("import sys\nsys.modules['obstore'] = None\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "hidden"))


def test_pages_read_logs_of_this_machine(tmp_path: Path) -> None:
    write_log(tmp_path / "sessions" / "a.mcap", [0.1, -0.1] * 20, lambda camera, row: road_jpeg(row))
    untrained_run(tmp_path / "runs" / "r")
    with served(tmp_path) as bench:
        with bench.asked("POST", "/sessions/a/rerun") as lines:
            assert "frame" in json.loads(lines.readline())
        shown = bench.get("/sessions/a/state").json["fingerprint"]
        for work in (f"/sessions/a/predictions/r?log={shown}", "/map.state?of=sessions/a&run=pixels"):
            assert bench.ask("POST", work, b"").status == 200

            def done(work: str = work) -> bool:
                state = bench.get(work).json
                return bool(state["about"] or state["problem"])

            wait_until(done)
            assert bench.get(work).json["problem"] == ""
