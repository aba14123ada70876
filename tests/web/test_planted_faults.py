"""Faults that were planted in a recording are found and removed in the page, in fewer than ten actions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.parquet as pq
import pytest

import dataset.cli
import recorder.import_cli
import recorder.log_cli
from common.car import Camera
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.logs import START_NS
from tests.helpers.pages import open_session, opened_page, selected_rows
from tests.helpers.panorama import hand, views
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MIRRORED_S = 10.0


@dataclass(frozen=True)
class Row:
    time_ns: int
    state: VehicleState
    pictures: Mapping[Camera, bytes]


@dataclass(frozen=True)
class Planted:
    """A recording with its faults, as the first and last rows that they hold for."""

    rows: list[Row]
    stuck: tuple[int, int]
    gap: tuple[int, int]  # the rows before it and after it
    frozen: tuple[int, int]
    mirrored: tuple[int, int]


def plant(rows: Sequence[Row]) -> Planted:
    """Each in a part of its own: four seconds of the very same steering, two that nobody recorded, three of the
    very same pictures, and ten, in the bends, whose steering has the other sign."""
    a_second = round(1e9 / float(np.median(np.diff([row.time_ns for row in rows]))))
    faulty = list(rows)
    eighth = len(rows) // 8
    stuck = eighth, eighth + 4 * a_second
    for at in range(stuck[0], stuck[1] + 1):
        faulty[at] = steered(faulty[at], 0.123)
    frozen = 3 * eighth, 3 * eighth + 3 * a_second
    for at in range(frozen[0] + 1, frozen[1] + 1):
        faulty[at] = dataclasses.replace(faulty[at], pictures=faulty[frozen[0]].pictures)
    length = round(MIRRORED_S * a_second)
    square = np.cumsum([row.state.steering**2 for row in rows])
    first = 4 * eighth + int(np.argmax((square[length:] - square[:-length])[4 * eighth : 7 * eighth]))
    for at in range(first, first + length):
        faulty[at] = steered(faulty[at], -faulty[at].state.steering)
    gap = 2 * eighth
    lost = 2 * a_second
    del faulty[gap : gap + lost]
    return Planted(
        faulty,
        stuck,
        (gap - 1, gap),
        (frozen[0] - lost, frozen[1] - lost),
        (first - lost, first + length - 1 - lost),
    )


def steered(row: Row, steering: float) -> Row:
    state = VehicleState()
    state.CopyFrom(row.state)
    state.steering = steering
    return dataclasses.replace(row, state=state)


def a_real_recording(recordings: Path, folder: Path) -> list[Row]:
    """Two laps of a person on the lake track."""
    assert call(recorder.import_cli.main, recordings / "lake_14hz", "whole", "--sessions", folder) == 0
    with Log(folder / "whole.mcap") as log:
        return [
            Row(message.log_time_ns, state, {"center": log.picture(message.sequence)})
            for message, state in log.vehicle_states()
        ]


def a_drawn_recording() -> list[Row]:
    pictures = views(600)
    wheel = hand(np.arange(len(pictures)) / 10)
    return [
        Row(
            START_NS + at * 100_000_000,
            VehicleState(steering=float(wheel[at]), throttle=0.5, speed_mph=15.0),
            {"center": picture},
        )
        for at, picture in enumerate(pictures)
    ]


@pytest.mark.parametrize("kind", ["drawn", pytest.param("real", marks=pytest.mark.long)])
def test_planted_faults_are_found_and_removed(
    kind: str,
    browser: Browser,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if kind == "real":
        rows = a_real_recording(request.getfixturevalue("recordings"), tmp_path)
    else:
        rows = a_drawn_recording()
    planted = plant(rows)
    log = tmp_path / "sessions" / "faulty.mcap"
    with LogWriter(log, {"source": "test"}) as writer:
        for number, row in enumerate(planted.rows):
            for camera, picture in row.pictures.items():
                writer.picture(camera, row.time_ns, number, picture)
            writer.vehicle(row.time_ns, number, row.state)
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
    assert selected[1:3] == [planted.gap, planted.frozen]
    (before_it, after_it), (first, last) = selected[0], selected[3]
    assert before_it <= planted.stuck[0] <= planted.stuck[1] <= after_it  # its pictures contradict it, too
    assert after_it - before_it < 1.5 * (planted.stuck[1] - planted.stuck[0])
    steering = np.array([row.state.steering for row in planted.rows])
    wrong = np.flatnonzero(np.abs(steering) > 0.1)
    wrong = wrong[(wrong >= planted.mirrored[0]) & (wrong <= planted.mirrored[1])]
    assert np.mean((wrong >= first) & (wrong <= last)) > 0.9
    assert len(wrong) > 0.2 * (planted.mirrored[1] - planted.mirrored[0])

    # what the page has done, as the commands see it: the log is as it was, and an index is made without these rows
    assert log.read_bytes() == before
    capsys.readouterr()
    assert call(recorder.log_cli.main, "tag", log) == 0
    assert capsys.readouterr().out == "".join(f"exclude: rows {a} to {b}\n" for a, b in selected)
    index = tmp_path / "index"
    assert call(dataset.cli.main, "--sessions", log.parent, "--index", index, "--labels", "as-recorded") == 0
    used = set(pq.read_table(index / "samples.parquet")["row"].to_pylist())
    assert len(used) > len(planted.rows) / 4
    assert not used & {row for a, b in selected for row in range(a, b + 1)}
