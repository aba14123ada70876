"""Predicted against driven steering on the page of a run: each point leads to its picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.parquet as pq

from dataset import IndexConfig, build_index
from model import train
from model.evaluation.predict_log import predict_log
from tests.helpers.logs import write_log
from tests.helpers.pages import opened_page
from tests.helpers.toy import SMALL, STEERING, road
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser


def test_each_point_leads_to_its_picture(browser: Browser, tmp_path: Path) -> None:
    log = write_log(tmp_path / "sessions" / "toy.mcap", STEERING, road, cameras=["center"])
    config = IndexConfig(flip=False, max_uses=1, block_s=0.5, gap_s=0)
    index = build_index([log], tmp_path / "index", config).path
    run = train(index, tmp_path / "runs" / "first", SMALL).run
    predicted = predict_log(log, [run]).predicted["first"]
    frames = pq.read_table(tmp_path / "index" / "frames" / "toy.parquet", columns=["row", "split"]).to_pylist()
    held_out = {frame["row"] for frame in frames if frame["split"] == "validation"}
    assert 0 < len(held_out) < len(STEERING)
    with served(tmp_path) as bench:
        wait_until(lambda: "reading" not in bench.get("/runs").text)
        stretches = bench.get("/index/toy/held-out").json
        assert {row for first, last in stretches for row in range(first, last + 1)} == held_out
        with opened_page(browser, f"{bench.address}/runs/first") as page:
            page.click("#scatter-show")
            page.wait_for_selector(f"#scatter[data-shown='{len(STEERING)}']")
            assert "held out" in page.inner_text("#scatter-legend")
            page.locator("#scatter-cloud").scroll_into_view_if_needed()
            box = page.locator("#scatter-cloud canvas").first.bounding_box()
            assert box is not None
            # the same distance across and up, both with room for the largest, 14 pixels from the nearer edges
            most = max(0.1, *np.abs(STEERING), *np.abs(predicted))
            scale = (min(box["width"], box["height"]) - 28) / (2 * most)
            row = int(np.argmax(STEERING))
            across, up = STEERING[row] * scale, float(predicted[row]) * scale
            middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            page.mouse.move(middle[0] + across, middle[1] - up)
            page.mouse.down()
            page.mouse.up()
            page.wait_for_selector("#scatter-under img:visible")
            words = page.inner_text("#scatter-under-words")
            assert f"{25 * STEERING[row]:.1f}° driven" in words
            shown = int(words.split()[1].rstrip(":"))
            assert STEERING[shown] == STEERING[row]  # the same place, perhaps of another lap
            page.focus("#scatter-cloud")
            page.keyboard.press("ArrowLeft")
            words = page.inner_text("#scatter-under-words")
            shown = int(words.split()[1].rstrip(":"))
            page.keyboard.press("Enter")
            page.wait_for_selector("#session[data-run=first]")
            wait_until(lambda: page.get_attribute("#curves", "aria-valuenow") == str(shown))
