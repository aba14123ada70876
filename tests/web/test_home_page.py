"""The first page: what the project has, and one next step."""

from __future__ import annotations

import html
import re
from pathlib import Path

from model.runs.run_files import keep_result
from tests.helpers.logs import write_log
from tests.helpers.runs import a_run
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, plain, served


def main_buttons(bench: Served) -> list[str]:
    """The buttons that stand out."""
    found = re.findall(r'<(?:a|button) class="[^"]*\bmain"[^>]*>(.*?)</', bench.get("/").text)
    return [plain(text) for text in found]


def test_a_new_project_begins_at_the_wheel(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        assert main_buttons(bench) == ["Take the wheel"]
        page = bench.get("/").text
        assert 'href="/import"' in page
        assert 'name="form" value="demo"' in page


def test_each_stage_of_a_project_has_its_next_step(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        write_log(tmp_path / "sessions" / "mine.mcap", [0.1] * 30)
        wait_until(lambda: main_buttons(bench) == ["Train a network"])
        run = a_run(tmp_path / "runs", "first", 2.0, seed=0)
        wait_until(lambda: main_buttons(bench) == ["Watch it drive"])
        assert "The network first has not driven yet." in bench.get("/").text
        drive = {"track": "lake", "set_speed_mph": 10.0, "interventions": 2, "distance_m": 500.0}
        keep_result(run, "simulator", drive)
        wait_until(lambda: main_buttons(bench) == ["Drive with it, and take over"])
        assert "2 times helped in 0.5 km" in plain(bench.get("/").text)
        keep_result(run, "simulator", drive | {"interventions": 0})
        wait_until(lambda: main_buttons(bench) == ["Try it on another road"])
        assert "drives" in plain(bench.get("/").text)
        (tmp_path / "sessions" / "half.mcap").write_bytes(
            (tmp_path / "sessions" / "mine.mcap").read_bytes()[:-600]
        )
        wait_until(lambda: main_buttons(bench) == ["Look after half"])


def test_the_form_of_another_road_knows_a_network_of_any_name(tmp_path: Path) -> None:
    run = a_run(tmp_path / "runs", "my & 'network'", 2.0, seed=0)
    drive = {"track": "lake", "set_speed_mph": 10.0, "interventions": 0, "distance_m": 500.0}
    keep_result(run, "simulator", drive)
    with served(tmp_path) as bench:
        write_log(tmp_path / "sessions" / "mine.mcap", [0.1] * 30)
        wait_until(lambda: main_buttons(bench) == ["Try it on another road"])
        (address,) = re.findall(r'class="button main" href="([^"]*)"', bench.get("/").text)
        assert 'name="run" value="my &amp; &#39;network&#39;"' in bench.get(html.unescape(address)).text
