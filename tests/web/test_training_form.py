"""The form of a training: what people change is at hand, the rest is folded, and its time is named beforehand."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import dataset.cli
from driving import road_jpeg, untrained_run
from histories import epoch_line, write_lines
from logs import write_log
from pages import opened_page
from udacity import call
from web.index.index_view import view_index
from web.jobs.job_forms import FORMS, JobForm
from web.runs.training_cost import EarlierTraining, time_words, training_cost
from workbench import Served, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CPU = EarlierTraining("first", "original", "cpu", 100.0)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    """An index, and a run that learnt 400 samples a second from it."""
    steering = 0.3 * np.sin(np.arange(100) / 9)
    log = write_log(tmp_path / "sessions" / "lake.mcap", steering.tolist(), lambda camera, row: road_jpeg(row))
    assert call(dataset.cli.main, "--sessions", log.parent, "--index", tmp_path / "index") == 3
    run = untrained_run(tmp_path / "runs" / "first")
    config = json.loads((run / "config.json").read_text())
    config.update(training={"epochs": 1, "recipe": "people"}, machine={"device": "cpu"})
    (run / "config.json").write_text(json.dumps(config))
    write_lines(run / "metrics.jsonl", [epoch_line(1)])
    with served(tmp_path) as found:
        yield found


def test_the_time_is_that_of_the_last_run_of_the_network() -> None:
    found = training_cost(1000, 10, "original", "auto", [CPU])
    assert found is not None
    assert found.seconds["original"] == 100.0
    assert found.seconds["small"] == pytest.approx(100 * 270 / 4798)  # the measured ratio
    newest = [EarlierTraining("second", "small", "cpu", 5000.0), CPU]
    both = training_cost(1000, 10, "original", "auto", newest)
    assert both is not None
    assert (both.seconds["original"], both.seconds["small"]) == (100.0, 2.0)
    assert both.by == CPU
    assert both.words("original").startswith("about 2 min for original (")
    assert "small 2 s" in both.words("original")


def test_a_time_that_no_run_tells_is_not_made_up() -> None:
    assert training_cost(1000, 10, "original", "auto", []) is None
    assert training_cost(1000, 10, "original", "cuda", [CPU]) is None
    assert training_cost(1000, 10, "original", "auto", [EarlierTraining("r", "original", "cpu", math.nan)]) is None
    gpu = training_cost(1000, 10, "small", "auto", [EarlierTraining("r", "original", "cuda", 1e4)])
    assert gpu is not None
    assert list(gpu.seconds) == ["original"]  # on a GPU, a processor's ratios do not hold
    assert gpu.words("small").startswith("time not known (original 1 s)")
    assert [time_words(each) for each in (0.1, 80, 600, 20_000, 100_000)] == [
        "1 s",
        "80 s",
        "10 min",
        "5.6 h",
        "28 h",
    ]


def test_the_page_names_the_time_and_the_command(browser: Browser, bench: Served) -> None:
    samples = sum(view_index(bench.folder / "index").after)
    with opened_page(browser, f"{bench.address}/jobs?start=train&dropout=0.1") as page:
        form = page.locator("details[open] form[action='/jobs']").first
        page.wait_for_selector(f".cost:has-text('10 epochs of {samples:,} samples: about')")
        assert "by the speed of first on cpu" in form.locator(".cost").inner_text()
        assert form.locator("[name=dropout]").is_visible()  # a value that is given is shown
        form.locator("[name=network]").select_option("small")
        form.locator("[name=rate]").fill("3e-4")
        form.locator("[name=batch]").fill("64")
        form.locator("[name=targets]").select_option("steering speed")
        form.locator("[name=device]").select_option("cpu")
        form.locator("[name=epochs]").fill("2")
        page.wait_for_selector(f".cost:has-text('2 epochs of {samples:,} samples')")
        words = "bc-train --network=small --epochs=2 --rate=3e-4 --batch=64 --targets steering speed --device=cpu"
        page.wait_for_selector(f"#command-train:has-text('{words}')")
    for query in ("epochs=many", "on=lake", "device=cuda", "epochs="):
        known = bool(bench.get(f"/jobs.cost?{query}").text)
        assert known == (query == "epochs="), query


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_every_flag_of_a_form_is_one_of_its_command(form: JobForm) -> None:
    page = (Path(__file__).parents[2] / "docs" / "commands.md").read_text()  # a test holds it to `--help-all`
    block = page.partition(f"<!-- generated: {form.command[0]} -->")[2].partition("<!-- end")[0]
    known = set(re.findall(r"--[a-z-]+", block))
    flags = {field.as_flag for field in form.fields} | {f"--{name}" for name in form.folders + form.of_named}
    assert flags - {""} <= known
