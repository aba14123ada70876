"""Addresses and names that nobody would type: each gets a response of its own, never a bug's."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.workbench import Served, served


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    write_log(tmp_path / "sessions" / "a.mcap", [0.1, 0.2, 0.3], lambda camera, row: road_jpeg(row))
    (tmp_path / "runs" / "r").mkdir(parents=True)
    (tmp_path / "runs" / "r" / "config.json").write_text("{}")
    with served(tmp_path) as server:
        yield server


@pytest.mark.parametrize(
    "path",
    [
        "/sessions/a/pictures/center/{}",
        "/sessions/a/attention/r/{}",
        "/runs/r/worst/{}/0.jpg",
        "/runs/r/worst/0/{}.jpg",
        "/index.altered/{}/0.jpg",
        "/index.altered/0/{}.jpg",
    ],
)
def test_what_is_no_number_of_a_picture_is_not_there(bench: Served, path: str) -> None:
    for number in ("1" * 5000, "-1", "%D9%A1"):
        answer = bench.get(path.format(number))
        assert answer.status == 404
        assert "expected a number in the address" in answer.json["error"]
