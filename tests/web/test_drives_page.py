"""The page of drives: what each drive's log has counted, its events, and where the car was."""

from __future__ import annotations

import re
from pathlib import Path

from tests.helpers.drives import a_drive
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served


def test_drives_stand_beside_one_another_and_on_one_map(tmp_path: Path) -> None:
    (tmp_path / "drives").mkdir()
    a_drive(tmp_path / "drives" / "one.mcap", "<b>r")
    a_drive(tmp_path / "drives" / "two.mcap", "r")
    (tmp_path / "drives" / "bad.mcap").write_bytes(b"no log")
    with served(tmp_path) as bench:
        wait_until(lambda: bench.get("/drives").text.count("87.5") == 2)
        text = bench.get("/drives").text
        assert "0.25" in text
        assert "damaged" in text
        assert "<b>r" not in text
        assert bench.get("/drives/one/links").text.strip() == "driven by &lt;b&gt;r"
        assert text.count("<polyline") == 1  # the newest one, until others are chosen
        link = r'<a href="(/drives/one#row=[^"]*)" title="the first intervention'
        assert re.findall(link, bench.get("/drives").text)
        for by in ("drive", "speed", "who+drove", "none"):
            shown = bench.get(f"/drives?log=one&log=two&log=bad&log=none&by={by}").text
            assert shown.count("<polyline") == 2
            assert "being read" not in shown
            assert re.findall(r'<a href="(/drives/\w+#row=\d+)"><circle cx="([\d.]+)"', shown) == [
                ("/drives/one#row=5", "50.0"),
                ("/drives/two#row=5", "50.0"),
            ]


def test_the_map_shows_where_the_steering_was_not_the_experts(tmp_path: Path) -> None:
    a_drive(tmp_path / "drives" / "one.mcap", "r")
    with served(tmp_path) as bench:
        wait_until(lambda: "being read" not in bench.get("/drives").text)
        shown = bench.get("/drives?log=one&by=error").text
        # a path's part has the colour of the row that it begins at; the last row begins none
        assert re.findall(r'<polyline class="([\w-]+)" points="([-\d.]+),', shown) == [
            ("step-none", "0.00"),
            ("step-0", "50.00"),
            ("step-2", "60.00"),
            ("step-5", "70.00"),
        ]


def test_without_drives_it_reports_how_to_begin(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        assert "No test drives yet" in bench.get("/drives").text
