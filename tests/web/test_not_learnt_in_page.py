"""A session's page shows which rows training leaves out by default: those that the index leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import dataset.cli
from dataset.samples.samples_format import not_learnt_in
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS
from tests.helpers.pages import open_session, opened_page
from tests.helpers.udacity import call
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

PARTS = [(200, 24.0, 0.0), (10, 0.2, 0.0), (20, 3.0, 1.0), (10, 6.0, -0.4), (10, 12.0, -1.0), (200, 24.0, 0.0)]
"""Rows at a speed in mph with a steering: a car that hits a wall, manoeuvres, and drives on."""

HATCHED = """(rows) => {
  const canvas = document.querySelector('#curves canvas');
  const over = document.querySelector('#curves .u-over').getBoundingClientRect();
  const left = over.left - canvas.getBoundingClientRect().left;
  const scale = canvas.width / canvas.getBoundingClientRect().width;
  const y = Math.round((over.top - canvas.getBoundingClientRect().top + over.height * 0.15) * scale);
  const [from, to] = rows.map(row => Math.round((left + over.width * row / 449) * scale));
  const data = canvas.getContext('2d').getImageData(from, y, to - from, 1).data;
  const colors = Array.from({length: to - from}, (_, at) => data.slice(4 * at, 4 * at + 4).join());
  return colors.filter((color, at) => at && color !== colors[at - 1]).length > 8;
}"""
"""Whether the colour changes often between two rows, above the curves: more often than at lines of the grid."""


def test_what_training_leaves_out_is_hatched(browser: Browser, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "sessions" / "a.mcap", {"source": "test"}) as writer:
        rows = [(mph, steering) for count, mph, steering in PARTS for _ in range(count)]
        for row, (mph, steering) in enumerate(rows):
            now_ns = START_NS + row * 100_000_000
            writer.picture("center", now_ns, row, road_jpeg(row))
            state = VehicleState(steering=steering, throttle=0.5, brake=0.0, speed_mph=mph)
            writer.vehicle(now_ns, row, state)
    index = tmp_path / "index"
    assert call(dataset.cli.main, "--sessions", tmp_path / "sessions", "--index", index) == 0
    (line,) = not_learnt_in(index)
    assert "a (40 frames of crashes, 20 frames of manoeuvres around these)" in line
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions/a") as page:
        open_session(page)
        assert page.inner_text("#not-learnt") == "hatched: 60 rows that training leaves out by default"
        assert page.evaluate(HATCHED, [205, 235])
        assert not page.evaluate(HATCHED, [300, 330])
