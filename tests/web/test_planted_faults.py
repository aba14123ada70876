"""Faults that were planted in a recording are found and removed in the page, in fewer than ten actions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.parquet as pq
import pytest

import dataset.cli
import recorder.log_cli
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.logs import START_NS
from tests.helpers.pages import open_session, opened_page, selected_rows
from tests.helpers.panorama import hand, views
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROWS = 600  # ten a second
STUCK = 75, 115
LOST = 150, 170  # nobody recorded these rows; the rows after them have numbers lower by 20
FROZEN = 225, 255
MIRRORED = 100  # rows in the bends, whose steering has the other sign


def write_faulty(log: Path) -> tuple[list[float], tuple[int, int]]:
    """Write the log. Return its steering, and the first and last mirrored row."""
    pictures, steering = list(views(ROWS)), hand(np.arange(ROWS) / 10)
    square = np.cumsum(steering**2)
    first = 300 + int(np.argmax((square[MIRRORED:] - square[:-MIRRORED])[300:525]))
    steering[first : first + MIRRORED] *= -1
    steering[STUCK[0] : STUCK[1] + 1] = 0.123
    pictures[FROZEN[0] : FROZEN[1] + 1] = [pictures[FROZEN[0]]] * (FROZEN[1] + 1 - FROZEN[0])
    kept = [at for at in range(ROWS) if not LOST[0] <= at < LOST[1]]
    with LogWriter(log, {"source": "test"}) as writer:
        for row, at in enumerate(kept):
            time_ns = START_NS + at * 100_000_000
            writer.picture("center", time_ns, row, pictures[at])
            state = VehicleState(steering=float(steering[at]), throttle=0.5, speed_mph=15.0)
            writer.vehicle(time_ns, row, state)
    return steering[kept].tolist(), (first - 20, first + MIRRORED - 1 - 20)


def test_planted_faults_are_found_and_removed(
    browser: Browser, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "sessions" / "faulty.mcap"
    steering, mirrored = write_faulty(log)
    before = log.read_bytes()

    actions = 1
    selected = []
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions/faulty") as page:
        open_session(page)
        page.click("#look")
        page.wait_for_selector("#look", state="hidden")
        for number in range(4):
            page.keyboard.press("j")
            wait_until(lambda: f"; {4 - number} of 4 stretches" in page.inner_text("#status"))  # noqa: B023
            selected.append(selected_rows(page))
            page.keyboard.press("x")
            page.wait_for_selector(f"#session[data-tags='{number + 1}']")
            actions += 2
        page.keyboard.press("j")
        wait_until(lambda: "all odd stretches are excluded" in page.inner_text("#status"))
    assert actions < 10
    assert selected[1:3] == [(149, 150), (FROZEN[0] - 20, FROZEN[1] - 20)]
    (before_it, after_it), (first, last) = selected[0], selected[3]
    assert before_it <= STUCK[0] <= STUCK[1] <= after_it  # its pictures contradict it, too
    assert after_it - before_it < 1.5 * (STUCK[1] - STUCK[0])
    wrong = np.flatnonzero(np.abs(steering) > 0.1)
    wrong = wrong[(wrong >= mirrored[0]) & (wrong <= mirrored[1])]
    assert np.mean((wrong >= first) & (wrong <= last)) > 0.9
    assert len(wrong) > 0.2 * MIRRORED

    # what the page has done, as the commands see it: the log is as it was, and an index is made without these rows
    assert log.read_bytes() == before
    capsys.readouterr()
    assert call(recorder.log_cli.main, "tag", log) == 0
    assert capsys.readouterr().out == "".join(f"exclude: rows {a} to {b}\n" for a, b in selected)
    index = tmp_path / "index"
    assert call(dataset.cli.main, "--sessions", log.parent, "--index", index, "--labels", "as-recorded") == 0
    used = set(pq.read_table(index / "samples.parquet")["row"].to_pylist())
    assert len(used) > len(steering) / 4
    assert not used & {row for a, b in selected for row in range(a, b + 1)}
