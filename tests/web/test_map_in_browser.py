"""The map of pictures: alike ones lie together, a drag chooses, and a choice is tagged and undone as one."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

import dataset.cli
from model.runs.run_files import WEIGHTS
from recorder import Log
from recorder.log.tags import Tag, read_tags
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.histories import epoch_line, write_lines
from tests.helpers.logs import write_log
from tests.helpers.pages import opened_page
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served
from web.processes import picture_maps
from web.processes.picture_maps import COLUMNS

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROWS = 120
NIGHT = range(70, 100)  # rows that look different
SAME = range(100, 110)  # rows of one picture
ODD_ONE = 115
STEERING = [round(0.4 * np.sin(row / 7), 3) for row in range(ROWS)]


def scene(camera: str, row: int) -> bytes:
    """A road by day, by night, at a standstill; and one picture that is like no other."""
    number = SAME[0] if row in SAME else row
    picture = cv2.imdecode(np.frombuffer(road_jpeg(number), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    if row in NIGHT:
        picture = picture // 3
    if row == ODD_ONE:
        picture[:] = np.random.default_rng(0).integers(0, 256, picture.shape)
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Two sessions, both in the index, and a run that was never trained."""
    folder = tmp_path_factory.mktemp("map")
    write_log(folder / "sessions" / "scenes.mcap", STEERING, scene, cameras=["center"])
    write_log(
        folder / "sessions" / "day.mcap", STEERING[:30], lambda camera, row: road_jpeg(row), cameras=["center"]
    )
    assert call(dataset.cli.main, "--sessions", folder / "sessions", "--index", folder / "index") == 0
    run = untrained_run(folder / "runs" / "r")
    changed_config(run, training={"epochs": 1, "recipe": "people"}, data={})
    write_lines(run / "metrics.jsonl", [epoch_line(1)])
    write_log(folder / "sessions" / "new.mcap", [0.1] * 5, cameras=[])
    with served(folder) as server:
        wait_until(lambda: "reading" not in server.get("/runs").text)
        yield server


def changed_config(run: Path, **changed: Any) -> None:
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps(config | changed))


def shown(page: Page, by: str = "pixels") -> None:
    page.wait_for_selector(f"#map[data-shown={by}]")


def columns(bench: Served, query: str) -> dict[str, Any]:
    """What a map has of each picture."""
    key = bench.get(f"/map.state?{query}").json["key"]
    values = np.frombuffer(bench.get(f"/map.points?key={key}").body, "<f4").reshape(len(COLUMNS), -1)
    return dict(zip(COLUMNS, values, strict=True))


def places(page: Page, points: dict[str, Any]) -> Any:
    """Where on the page the dots are (N, 2): all of the map, in its shape, 14 pixels from the nearer edges."""
    box = page.locator("#cloud canvas").first.bounding_box()
    assert box is not None
    place = np.stack([points["x"], points["y"]], 1)
    size = np.array([box["width"], box["height"]])
    scale = ((size - 28) / np.ptp(place, 0)).min()
    return np.array([box["x"], box["y"]]) + size / 2 + (place - (place.min(0) + place.max(0)) / 2) * scale


def tags_of(bench: Served, name: str) -> list[Tag]:
    path = bench.folder / "sessions" / f"{name}.mcap"
    with Log(path) as log:
        return read_tags(path, log.fingerprint)


def drag(page: Page, corners: Any) -> None:
    page.mouse.move(*corners[0])
    page.mouse.down()
    for corner in corners[1:]:
        page.mouse.move(*corner)
    page.mouse.up()


def test_a_lasso_chooses_what_is_tagged_and_undone_as_one(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/map?of=sessions/scenes&run=pixels") as page:
        shown(page)
        points = columns(bench, "of=sessions/scenes&run=pixels")
        assert sorted(points["row"]) == list(range(ROWS))
        assert np.allclose(points["steering"][np.argsort(points["row"])], STEERING, atol=1e-6)
        at = places(page, points)
        page.mouse.move(*at[points["row"] == 5][0])
        page.wait_for_selector("#under-words:has-text('scenes, row')")
        night = np.isin(points["row"], list(NIGHT))
        middle, reach = at[night].mean(0), np.linalg.norm(at[night] - at[night].mean(0), axis=1).max() + 6
        is_within = np.linalg.norm(at - middle, axis=1) <= reach
        assert set(points["row"][is_within]) == set(NIGHT)  # they lie together, and nothing else there
        turns = np.linspace(0, 2 * np.pi, 60)
        drag(page, middle + reach * np.stack([np.cos(turns), np.sin(turns)], 1))
        page.wait_for_selector(f"#map[data-chosen='{len(NIGHT)}']")
        assert page.inner_text("#count") == "30 pictures"
        links = page.locator("#pictures a").evaluate_all("all => all.map(each => each.getAttribute('href'))")
        assert links == [f"/sessions/scenes#row={row}" for row in NIGHT]
        page.keyboard.press("x")
        wait_until(lambda: tags_of(bench, "scenes") == [(70, 99, "exclude")])
        page.wait_for_selector("#pictures .excluded")
        page.select_option("#by", "flag")
        assert "excluded 30" in page.inner_text("#legend")
        page.reload()  # undone later, too
        shown(page)
        page.keyboard.press("u")
        wait_until(lambda: tags_of(bench, "scenes") == [])
        page.keyboard.press("r")
        wait_until(lambda: tags_of(bench, "scenes") == [(70, 99, "exclude")])
        page.click("#undo")
        wait_until(lambda: tags_of(bench, "scenes") == [])
        page.wait_for_selector("#undo:disabled")
        assert page.locator("#commands").text_content() == "\n".join(
            f"bc-log tag {bench.folder}/sessions/scenes.mcap exclude --rows 70 99{flag}"
            for flag in ("", " --remove", "", " --remove")
        )


def test_lonely_ones_and_doubles_are_one_click_away(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/map?of=sessions/scenes&run=pixels") as page:
        shown(page)
        page.click("#lonely")
        page.wait_for_selector("#map[data-chosen='1']")
        assert page.locator("#pictures a").get_attribute("href") == f"/sessions/scenes#row={ODD_ONE}"
        page.click("#doubles")
        page.wait_for_selector(f"#map[data-chosen='{len(SAME)}']")
        page.keyboard.press("f")
        wait_until(lambda: tags_of(bench, "scenes") == [(100, 109, "fine")])
        page.click("#undo")
        wait_until(lambda: tags_of(bench, "scenes") == [])
        page.click("#pictures a >> nth=3")
        page.wait_for_selector("#session[data-ready]")
        wait_until(lambda: page.get_attribute("#curves", "aria-valuenow") == "103")


def test_it_needs_no_mouse(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/map?of=sessions/scenes&run=pixels") as page:
        shown(page)
        page.focus("#groups button")
        count = int(page.inner_text("#groups button >> nth=0").split()[0])
        page.keyboard.press("Enter")  # a group, from the list
        page.wait_for_selector(f"#map[data-chosen='{count}']")
        page.keyboard.press("Escape")
        page.wait_for_selector("#map[data-chosen='0']")
        page.focus("#cloud")
        page.keyboard.press("ArrowRight")
        first = page.inner_text("#under-words")
        page.keyboard.press("ArrowRight")
        assert page.inner_text("#under-words") != first
        for key in ("+", "-", "0"):
            page.keyboard.press(key)
        page.keyboard.press("Space")
        page.wait_for_selector("#map[data-chosen='1']")
        page.keyboard.press("n")
        page.wait_for_selector("#map[data-chosen='24']")
        page.keyboard.press("t")
        page.keyboard.type("bend")
        page.keyboard.press("Enter")
        wait_until(lambda: {tag.name for tag in tags_of(bench, "scenes")} == {"bend"})
        page.keyboard.press("u")
        wait_until(lambda: tags_of(bench, "scenes") == [])
        row = page.inner_text("#under-words").split("row ")[1].split()[0]
        page.focus("#cloud")
        page.keyboard.press("Enter")
        page.wait_for_url(f"**/sessions/scenes#row={row}")


def test_all_sessions_of_the_index_lie_on_one_map(browser: Browser, bench: Served) -> None:
    with opened_page(browser, f"{bench.address}/index") as page:
        page.click("text=Map of its pictures")
        shown(page, "r")  # by the newest network
        points = columns(bench, "run=r")
        assert len(points["row"]) == ROWS + 30
        assert np.isfinite(points["predicted"]).all()
        page.select_option("#by", "error")
        page.select_option("#by", "session")
        page.click("#legend button:has-text('day')")
        page.wait_for_selector("#map[data-chosen='30']")
        page.click("#legend button:has-text('scenes')")
        page.wait_for_selector(f"#map[data-chosen='{ROWS}']")
        page.click("#more")
        assert page.locator("#pictures a").count() == ROWS
        box = page.locator("#cloud").bounding_box()
        assert box is not None
        left, top = box["x"] + 2, box["y"] + 2
        right, bottom = left + box["width"] - 4, top + box["height"] - 4
        drag(page, [(left, top), (right, top), (right, bottom), (left, bottom)])
        page.wait_for_selector(f"#map[data-chosen='{ROWS + 30}']")
        page.keyboard.press("x")
        wait_until(lambda: tags_of(bench, "scenes") == [(0, ROWS - 1, "exclude")])
        wait_until(lambda: tags_of(bench, "day") == [(0, 29, "exclude")])
        page.wait_for_selector("#undo:not(:disabled)")
        page.keyboard.press("u")  # of both, as one
        wait_until(lambda: tags_of(bench, "scenes") == tags_of(bench, "day") == [])


def test_of_more_pictures_than_are_shown_each_stands_for_some(
    browser: Browser, bench: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture_maps, "MAX_POINTS", 40)
    with opened_page(browser, f"{bench.address}/map?of=sessions/scenes&run=pixels") as page:
        shown(page)
        assert "One of 3 pictures is shown" in page.inner_text("#status")
        points = columns(bench, "of=sessions/scenes&run=pixels")
        assert sorted(points["row"]) == list(range(0, ROWS, 3))
        page.click("#lonely")
        page.wait_for_selector("#map[data-chosen='1']")
        first = int(points["row"][points["alone"].argmax()])
        page.keyboard.press("x")
        wait_until(lambda: tags_of(bench, "scenes") == [(first, first + 2, "exclude")])
        page.keyboard.press("u")
        wait_until(lambda: tags_of(bench, "scenes") == [])


@pytest.fixture
def hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Once called, what makes maps does not begin."""

    def begin() -> None:
        (tmp_path / "sitecustomize.py").write_text("import time\ntime.sleep(1000)\n")
        monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)

    return begin


def test_it_can_be_stopped_and_made_again(browser: Browser, bench: Served, hold: Callable[[], None]) -> None:
    hold()
    with opened_page(browser, f"{bench.address}/map?of=sessions/day&run=pixels") as page:
        page.wait_for_selector("#progress:visible")
        wait_until(lambda: bench.get("/map.state?of=sessions/day&run=pixels").json.get("is_begun"))
        page.click("#stop")
        page.wait_for_selector("#problem:has-text('stopped')")
        wait_until(lambda: "stopped" in bench.get("/map.state?of=sessions/day&run=pixels").json["problem"])
        os.environ["PYTHONPATH"] = os.environ["PYTHONPATH"].partition(os.pathsep)[2]
        page.click("#again")
        shown(page)


def test_while_a_map_is_made_its_tools_wait(browser: Browser, bench: Served, hold: Callable[[], None]) -> None:
    with opened_page(browser, f"{bench.address}/map?of=sessions/day&run=pixels") as page:
        shown(page)
        page.click("#groups button")
        page.click("#fine")
        wait_until(lambda: tags_of(bench, "day"))
        hold()
        page.select_option("#run", "r")
        page.wait_for_selector("#progress:visible")
        assert [page.is_enabled(f"#{tool}") for tool in ("lonely", "doubles", "whole", "by")] == [False] * 4
        page.click("#undo")
        wait_until(lambda: page.inner_text("#status").startswith("undone: add fine"))
        assert not tags_of(bench, "day")
        page.click("#stop")


def test_what_cannot_be_shown_reports_why(bench: Served) -> None:
    def asked(query: str, method: str = "POST") -> Any:
        return bench.ask(method, f"/map.state?{query}")

    assert asked("of=sessions/none").status == 404
    assert asked("of=elsewhere/day").status == 404
    assert asked("of=sessions/..%2fday").status == 404
    assert asked("run=none").status == 404
    assert bench.get("/map?of=elsewhere/day").status == 404
    assert bench.get("/map.points?key=..%2f..%2fx").status == 404
    assert bench.get(f"/map.points?key={'0' * 64}").status == 404
    assert bench.ask("POST", "/map.stop?key=x").status == 204  # nothing is being made: nothing to stop
    assert bench.ask("POST", "/map.state", b"", Sec_Fetch_Site="cross-site").status == 403
    asked("of=sessions/new&run=pixels")
    problem = wait_until(lambda: asked("of=sessions/new&run=pixels", "GET").json["problem"])
    assert "no picture of the centre camera" in problem
    weights = untrained_run(bench.folder / "runs" / "diverged") / WEIGHTS
    save_file({name: layer * np.nan for name, layer in load_file(weights).items()}, weights)
    asked("of=sessions/day&run=diverged")
    problem = wait_until(lambda: asked("of=sessions/day&run=diverged", "GET").json["problem"])
    assert "not finite" in problem
    shutil.rmtree(weights.parent)
    own = untrained_run(bench.folder / "runs" / "own")
    changed_config(own, network={"name": "mine.py:Net", "arguments": {}, "file_sha256": "0" * 64})
    assert "your own code" in asked("of=sessions/day&run=own").json["error"]
    assert '<option value="r" selected>' in bench.get("/map?of=sessions/day").text  # the newest that can be run


def test_a_session_that_has_changed_since_is_left_out(bench: Served) -> None:
    path = bench.folder / "sessions" / "day.mcap"
    before = path.read_bytes()
    write_log(path, STEERING[:9], lambda camera, row: road_jpeg(row), cameras=["center"], overwrite=True)
    try:
        bench.ask("POST", "/map.state?run=pixels")
        about = wait_until(lambda: bench.get("/map.state?run=pixels").json["about"])
    finally:
        path.write_bytes(before)
    assert len(about["notes"]) == 1
    assert "day.mcap: the log has changed" in about["notes"][0]
