"""Every page, light and dark: axe-core finds nothing serious, all of it is reached by the keyboard, nothing is cut
off at the right."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pytest

import dataset.cli
import recorder.log_cli
from tests.helpers.drives import a_drive
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.histories import epoch_line, step_lines, write_lines
from tests.helpers.logs import write_log
from tests.helpers.pages import window_of, with_token
from tests.helpers.udacity import call, make_recording, paths
from tests.helpers.waiting import wait_until
from tests.helpers.wheel_host import driving_host
from tests.helpers.workbench import Served, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

PAGES: Final = {
    "/sessions": "#s-faulty img",
    "/sessions?where=no_such_column": "#list :text('no_such_column')",
    "/sessions/faulty": "#session[data-ready]",
    "/sessions/damaged": ".rescue",
    "/map?run=pixels": "#map[data-shown=pixels]",
    "/map?of=sessions/faulty&run=r&by=flag": "#map[data-shown=r]",
    "/index": "#list, main img",
    "/runs?run=r": "#plots canvas",
    "/runs/r": "#plots canvas",
    "/drives?log=d&by=speed": "circle",
    "/drives/d": "#session[data-course] circle",
    "/runs.compare?a=r&b=other": "form button",
    "/import": "#drop",
    "/import/lake": "form .main",
    "/jobs?start=train": "details[open] button",
    "/wheel?driver=run": "form.begin",
    "/wheel/after/sessions/faulty": "form",
    "/nothing": "main",
}
"""Each page, and what stands in it when all of it is there."""
RUN: Final = """async (only) => {
  const found = await axe.run(document, {resultTypes: ['violations'], ...only});
  return found.violations.filter(each => ['serious', 'critical'].includes(each.impact))
    .map(each => [each.id, each.nodes.map(node => node.target.join(' ') + ': ' + node.failureSummary)]);
}"""
NOTE_WHAT_IS_REACHED: Final = """() => {
  window.reached = new Set([document.activeElement]);
  addEventListener("focusin", event => reached.add(event.target));
}"""
LEFT: Final = """() => {
  const all = document.querySelectorAll('a[href], button, input:not([type=hidden]), select, summary, [tabindex]');
  const wanted = [...all].filter(each => each.checkVisibility() && !each.disabled && each.tabIndex >= 0
    && (each.type !== 'radio' || each.checked));  // the others of its group are reached by the arrow keys
  return wanted.filter(each => !reached.has(each)).map(each => each.outerHTML.slice(0, 120));
}"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A session with something of everything, an index, a run with its worst frames, a drive, a job."""
    folder = tmp_path_factory.mktemp("bench")
    steering = 0.3 * np.sin(np.arange(300) / 9)
    steering[100:150] = 0.25
    faulty = write_log(folder / "sessions" / "faulty.mcap", steering.tolist(), lambda camera, row: road_jpeg(row))
    (folder / "sessions" / "damaged.mcap").write_bytes(b"no log")
    for name in ("exclude", "recovery"):
        assert call(recorder.log_cli.main, "tag", faulty, name, "--rows", 100, 149) == 0
    arguments = "faulty", "--sessions", faulty.parent, "--index", folder / "index"
    assert call(dataset.cli.main, *arguments) == 0
    run = untrained_run(folder / "runs" / "r")
    config = json.loads((run / "config.json").read_text())
    config.update(
        training={"epochs": 2, "recipe": "people"}, data={"logs": {"faulty": {}}, "settings": {"bins": 25}}
    )
    (run / "config.json").write_text(json.dumps(config))
    write_lines(run / "metrics.jsonl", [epoch_line(1), epoch_line(2)])
    write_lines(run / "steps.jsonl", step_lines(1))
    frame = {"session": "faulty", "row": 7, "log_time_ns": 7, "log_time_utc": "then", "recorded_deg": 1.0}
    shown = {**frame, "predicted_deg": 9.0, "error_deg": 8.0, "jpeg": base64.b64encode(road_jpeg(7)).decode()}
    write_lines(run / "worst.jsonl", [{"epoch": 2, "frames": [shown]}])
    untrained_run(folder / "runs" / "other")
    make_recording(folder / "recordings" / "lake", f"{paths(0)},0.1,0.5,0,9.5\n")
    a_drive(folder / "drives" / "d.mcap", "r")
    with served(folder) as server:
        wait_until(lambda: "reading" not in server.get("/runs").text)
        wait_until(lambda: "<circle" in server.get("/drives?log=d").text)
        yield server


def test_every_page_is_for_everybody(browser: Browser, bench: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    from axe_playwright_python.base import AXE_SCRIPT  # slow

    monkeypatch.setenv("BC_CACHE", str(bench.folder / "cache"))
    wrong: dict[str, Any] = {}
    with ExitStack() as drive, window_of(browser, 1280, 800) as page:
        for path, last in [*PAGES.items(), ("", "#wheel[data-frame]")]:
            if not path:  # the page at the wheel, last: a drive takes a processor as long as it lasts
                new = bench.folder / "sessions" / "new.mcap"
                path = drive.enter_context(driving_host(new, with_network=True)).address
            address = with_token(f"{bench.address}{path}")
            page.goto(address, wait_until="networkidle")  # axe fails in a list that changes
            page.wait_for_selector(last)
            page.evaluate(NOTE_WHAT_IS_REACHED)
            for _ in range(15):
                for _ in range(10):
                    page.keyboard.press("Tab")
                if not (left := page.evaluate(LEFT)):
                    break
            else:
                wrong[f"{path}, by the keyboard"] = left
            page.evaluate(AXE_SCRIPT)
            if violations := page.evaluate(RUN, {}):
                wrong[path] = violations
            page.emulate_media(color_scheme="dark")
            if violations := page.evaluate(RUN, {"runOnly": ["color-contrast"]}):
                wrong[f"{path}, dark"] = violations
            page.emulate_media(color_scheme="light")
            for width in (390, 1280, 2560):
                page.set_viewport_size({"width": width, "height": width * 9 // 16})
                wait_until(lambda: page.evaluate("document.documentElement.scrollWidth <= innerWidth"))
    assert wrong == {}
