"""The list of drives on one map; the page of a drive in a real browser: who drove, all steering on one plot, the
map, interventions first."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.writer import LogWriter
from tests.helpers.drives import a_drive
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS, STEP_NS
from tests.helpers.pages import open_session, opened_page
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROWS = 400
STUCK = (20, 90)  # the very same steering while driving: odd
OFF_ROAD = (240, 399)  # straight on, where the lake's road bends: first its outer wheels
TAKEOVERS = {200: PilotCommand.EXPERT, 230: PilotCommand.HUMAN}
"""Rows at which somebody else begins to drive, for 20 rows."""


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    write_drive(tmp_path / "drives" / "d.mcap")
    with served(tmp_path) as server:
        yield server


def write_drive(path: Path) -> None:
    """Eastwards, half a metre a row, on the lake's road by its name; pictures as bright as their row says."""
    with LogWriter(path, {"source": "drive", "run": "r", "track": "lake"}) as writer:
        for row in range(ROWS):
            now_ns = START_NS + row * STEP_NS
            pose = PoseInFrame()
            pose.pose.position.x = 0.5 * row
            steering = 0.1 if STUCK[0] <= row <= STUCK[1] else 0.001 * (row % 9)
            writer.picture("center", now_ns, row, road_jpeg(row))
            writer.pose(now_ns, row, pose)
            writer.vehicle(now_ns, row, VehicleState(steering=steering, throttle=0.5, brake=0.0, speed_mph=20.0))
            driver = next((who for at, who in TAKEOVERS.items() if at <= row < at + 20), PilotCommand.PILOT)
            command = PilotCommand(driver=driver, predicted_steering=0.5, steering=-0.25)
            if row >= 100:
                command.expert_steering = 0.75
            writer.command(now_ns, row, command)
            if driver == PilotCommand.EXPERT and row == 200:
                writer.event(now_ns, "the expert takes over: 0.95 of the half width", name="drive")
            if row == 230:
                writer.event(now_ns, "a person takes over", name="drive")


def opened_drive(page: Page) -> None:
    open_session(page)
    page.wait_for_selector(f"#session[data-course='{ROWS}']")


def now(page: Page) -> int:
    return int(page.get_attribute("#curves", "aria-valuenow") or 0)


def test_it_shows_who_drove_and_all_steering(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/drives/d") as page:
        opened_drive(page)
        assert page.locator("#drivers span").all_inner_texts() == ["network 90 %", "person 5 %", "expert 5 %"]
        colors = page.evaluate(
            """() => [0.25, 0.525, 0.6].map(share => {
                const canvas = document.querySelector('#drivers canvas');
                return [...canvas.getContext('2d').getImageData(share * canvas.width, 2, 1, 1).data].join();
            })"""
        )
        assert len(set(colors)) == 3  # network, expert, person
        page.evaluate("location.hash = 'row=150'")
        wait_until(lambda: now(page) == 150)
        assert "sent -6.3° · the expert's 18.8° · the network's 12.5°" in page.inner_text("#now")
        page.evaluate("location.hash = 'row=50'")
        wait_until(lambda: "the expert's -" in page.inner_text("#now"))  # no expert was there yet


def test_j_goes_to_what_led_to_interventions_first(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/drives/d") as page:
        opened_drive(page)
        shown = []
        for key in ("j", "j", "j", "j", "k", "k"):
            before = page.inner_text("#status")
            page.keyboard.press(key)
            wait_until(lambda: page.inner_text("#status") not in ("", before))  # noqa: B023
            words = page.inner_text("#selected").split()
            shown.append((int(words[1]), int(words[3])))
        # the two seconds before each that the network drove; then what is odd, and from the beginning
        assert shown == [(180, 200), (220, 230), STUCK, OFF_ROAD, STUCK, (220, 230)]
        page.keyboard.press("x")
        page.wait_for_selector("#session[data-tags='1']")
        for _ in range(3):
            page.keyboard.press("j")
        wait_until(lambda: "1 of 1 interventions" in page.inner_text("#status"))


def test_the_map_has_road_start_direction_and_scale_and_leads_to_moments(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/drives/d") as page:
        opened_drive(page)
        svg = page.locator("#course-map svg")
        assert svg.locator(".road, .start, .scale").count() == 3
        assert svg.locator(".direction").count() == 8
        assert [name.split("-")[-1] for name in classes(page)] == ["pilot", "expert", "pilot", "human", "pilot"]
        assert svg.locator(".scale-name").text_content() == "100 m"
        assert (svg.locator(".scale").get_attribute("d") or "").endswith("h100")
        svg.locator("a").nth(1).click()
        wait_until(lambda: now(page) == 220)
        assert "rows 220 to 230 selected" in page.inner_text("#selected")
        # the mouse over the path points at its moment, and brings the picture
        place = page.evaluate(
            """() => {
                const svg = document.querySelector('#course-map svg');
                const at = new DOMPoint(50, 0).matrixTransform(svg.getScreenCTM());
                return [at.x, at.y];
            }"""
        )
        page.mouse.move(*place)
        wait_until(lambda: abs(now(page) - 100) <= 3)
        picture = page.locator("#course-map .under-mouse")
        picture.wait_for(state="visible")
        wait_until(lambda: f"/center/{now(page)}?" in (picture.get_attribute("src") or ""))


def classes(page: Page) -> list[str]:
    names: list[str] = page.eval_on_selector_all(
        "#course-map .path", "all => all.map(each => each.getAttribute('class'))"
    )
    return names


def test_a_recording_has_none_of_it(browser: Browser, bench: Served) -> None:
    path = bench.folder / "sessions" / "s.mcap"
    with LogWriter(path, {"source": "test"}) as writer:
        writer.vehicle(START_NS, 0, VehicleState(steering=0.0))
    with opened_page(browser, f"{bench.address}/sessions/s") as page:
        open_session(page)
        assert page.locator("#course-map, #drivers, #events").count() == 0


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
