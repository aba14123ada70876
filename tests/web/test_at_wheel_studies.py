"""The studies of a person at the wheel run, in a real Chromium, and their players keep to the road."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

STUDIES = Path(__file__).parents[2] / "studies"

pytestmark = [pytest.mark.long, pytest.mark.needs("chromium")]


def run(name: str, *words: object) -> None:
    subprocess.run([sys.executable, STUDIES / name, *map(str, words)], check=True)


def test_each_key_event_has_its_delay(tmp_path: Path) -> None:
    run("at_wheel.py", "--seconds", 4, "--json", tmp_path / "found.json")
    result = json.loads((tmp_path / "found.json").read_text())
    assert 0 < result["delays"] <= 2 * result["presses"]


@pytest.mark.parametrize("device", ["keys", "mouse", "gamepad"])
def test_a_player_who_sees_the_page_alone_stays_on_the_road(tmp_path: Path, device: str) -> None:
    run("players.py", tmp_path, "--laps", 0.02, "--seeds", 9, "--devices", device, "--only", "*record lake")
    result = json.loads((tmp_path / "results" / f"devices_{device}-9_record_lake.json").read_text())
    assert result["rows"] > 0
    assert result["put back"] == 0
