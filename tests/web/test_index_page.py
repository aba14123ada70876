"""The page of the index: what it holds, and what other settings would change before anything is written."""

from __future__ import annotations

import html
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.parquet as pq
import pytest

import dataset.cli
import recorder.log_cli
from dataset import IndexConfig, Samples, build_index, decode, load
from model.config import TrainConfig
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import not_a_picture, write_log
from tests.helpers.pages import opened_page
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, plain, served
from web.index.index_view import session_bins_sketch

if TYPE_CHECKING:
    from playwright.sync_api import Browser

AWKWARD = "<b>a 'b' é"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("bench")
    sessions = folder / "sessions"
    turning = [0.05 * (row % 9) for row in range(400)]
    write_log(sessions / "left.mcap", [-turn for turn in turning], lambda camera, row: road_jpeg(row))
    write_log(sessions / f"{AWKWARD}.mcap", turning, lambda camera, row: road_jpeg(10_000 + row))
    arguments = ("--sessions", sessions, "--index", folder / "index", "--labels", "as-recorded")
    assert call(dataset.cli.main, *arguments) == 0
    with served(folder) as server:
        yield server


@pytest.fixture
def changed_bench(bench: Served, tmp_path: Path) -> Iterator[Served]:
    """The same, which is afterwards as it was."""
    index, tags = bench.folder / "index", bench.folder / "sessions" / "left.tags.jsonl"
    shutil.copytree(index, tmp_path / "index")
    yield bench
    shutil.rmtree(index)
    shutil.copytree(tmp_path / "index", index)
    tags.unlink()


def test_the_page_shows_what_the_index_holds(bench: Served) -> None:
    page = bench.get("/index").text
    assert "<b>a 'b'" not in page
    assert AWKWARD in plain(page)
    pictures = re.findall(r'<img[^>]* src="(/index[^"]*)"', page)
    assert len(pictures) == 1 + 2 * 2
    for address in pictures:
        answer = bench.get(html.unescape(address))
        assert (answer.status, answer.headers["content-type"]) == (200, "image/svg+xml")
        assert b"<rect" in answer.body or b"v-" in answer.body
    assert "no leak between training and validation" in bench.get("/index.leaks").text


@pytest.mark.parametrize("bins", [5, 40])
def test_a_session_is_sketched_in_the_bins_of_its_index(bins: int, tmp_path: Path) -> None:
    """By the square root of its samples in each, which are those of the whole index: it is alone there."""
    steering = [0.02 * (row % 50) - 0.2 for row in range(400)]  # 0.4, an edge of five bins, is among them
    log = write_log(tmp_path / "a.mcap", steering, not_a_picture, cameras=["center"])
    indexed = build_index([log], tmp_path / "index", IndexConfig(bins=bins))
    sketch = session_bins_sketch(indexed.path, "a").decode()
    bars = np.array(re.findall(r"v-([0-9.]+)h", sketch), np.float64)
    shares = np.sqrt([count for count in indexed.balance.after if count])
    assert bars == pytest.approx(28 * shares / shares.max(), abs=0.051)


def test_samples_are_shown_as_training_sees_them(bench: Served) -> None:
    """Beside the crops that they were made of; as in the first epoch of a training with default options."""
    page = bench.get("/index.altered").text
    pictures_shown = re.findall(r'<img src="(/index.altered/(\d+)/([01]).jpg[^"]*)"', page)
    reported = re.findall(
        r"<span>([^<]*)</span>\s*<span class=\"dim\">[^;]*, (-?[0-9.]+)° learnt; (.*) row (\d+), (\w+)</span>",
        page,
    )
    assert len(pictures_shown) == 2 * len(reported) > 4
    assert bench.get("/index.altered?others=1").text != page
    index, alterations = bench.folder / "index", TrainConfig().epoch_alterations
    with load(index, batch=1, alter_each_epoch=alterations) as loader, Samples(index) as samples:
        assert loader.alterations is not None
        table = samples.of_split("train")
        for number, (done, label_deg, session, row, camera) in enumerate(reported):
            as_driven, as_learnt = (
                decode(bench.get(html.unescape(pictures_shown[2 * number + at][0])).body) for at in (0, 1)
            )
            assert as_driven.shape == as_learnt.shape == (128, 128, 3)
            names = html.unescape(done).split(", ")
            wanted = {
                "session": html.unescape(session),
                "row": int(row),
                "camera": camera,
                "flip": "mirrored" in names,
                "alteration": "+".join(name for name in names if name != "mirrored"),
            }
            same = [at for at, sample in enumerate(table.to_pylist()) if wanted.items() <= sample.items()]
            apart = {}
            for at in same:
                (picture,) = pictures = loader.pictures_of(np.array([at])).copy()
                loader.alterations.alter(1, pictures, np.array([at]))
                apart[at] = np.abs(picture.astype(int) - as_learnt).mean()
            at = min(apart, key=lambda at: apart[at])
            assert apart[at] < 6  # a JPEG of it, noise included
            assert float(label_deg) == pytest.approx(25 * loader.labels(np.array([at]), 1)[0], abs=0.051)
    assert bench.get("/index.altered/99/0.jpg").status == 404
    assert bench.get("/index.altered/0/2.jpg").status == 404


def test_an_open_page_shows_an_index_that_is_built_meanwhile(browser: Browser, tmp_path: Path) -> None:
    folders = "--sessions", tmp_path / "sessions", "--index", tmp_path / "index"
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 400, lambda camera, row: road_jpeg(row))
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/index") as page:
        page.fill("[name=bins]", "21")  # what is typed stays
        assert call(dataset.cli.main, *folders) == 0
        page.wait_for_selector("text=25 bins")
        assert not page.locator("button:text('Prepare it')").count()
        before = page.get_attribute("img.bins", "src")
        assert call(dataset.cli.main, *folders, "--bins", "5") == 0
        page.wait_for_selector("text=5 bins; the largest")
        wait_until(lambda: page.get_attribute("img.bins", "src") != before)  # another picture
        write_log(tmp_path / "sessions" / "b.mcap", [0.1] * 400, lambda camera, row: road_jpeg(row))
        page.wait_for_selector("text=Newer than the training data, or changed since: b.")
        assert page.input_value("[name=bins]") == "21"


def test_other_settings_are_tried_before_they_are_written(changed_bench: Served) -> None:
    bench = changed_bench
    samples = bench.folder / "index" / "samples.parquet"
    before = samples.read_bytes()
    assert (
        call(recorder.log_cli.main, "tag", bench.folder / "sessions" / "left.mcap", "exclude", "--rows", 3, 9) == 0
    )
    asked = {"bins": "5", "labels": "as-recorded", "sessions": "left"}
    answer = bench.post("/index.try", **asked)
    assert answer.status == 303
    job = answer.headers["location"]
    wait_until(lambda: "running" not in bench.get(job).text)
    (address,) = re.findall(r'href="(/index\?[^"]*)"', bench.get(job).text)
    page = bench.get(html.unescape(address)).text
    assert "bins 25 → 5" in plain(page)
    assert f"{AWKWARD} not then" in plain(page)
    assert "excluded" in plain(page)  # of which there was none before
    assert samples.read_bytes() == before
    hidden = dict(re.findall(r'type="hidden" name="([^"]*)" value="([^"]*)"', page))
    assert hidden == {"form": "index", **asked}
    done = bench.post("/jobs", **hidden).headers["location"]
    wait_until(lambda: "running" not in bench.get(done).text)
    assert samples.read_bytes() != before
    assert "5 bins" in plain(bench.get("/index").text)


def test_a_training_takes_in_what_the_index_lacks(tmp_path: Path) -> None:
    folders = "--sessions", tmp_path / "sessions", "--index", tmp_path / "index"
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 400, lambda camera, row: road_jpeg(row))
    assert call(dataset.cli.main, *folders) == 0
    with served(tmp_path) as bench:
        write_log(tmp_path / "sessions" / "b.mcap", [0.2] * 400, lambda camera, row: road_jpeg(400 + row))
        wait_until(lambda: "First, the training data takes in b." in bench.get("/jobs?start=train").text)
        job = bench.post("/jobs", form="train", name="r", epochs="1", network="small").headers["location"]
        assert re.search("bc-index --sessions=.* &amp;&amp; bc-train --name=r ", bench.get(job).text)
        wait_until(lambda: "Newer than the training data" not in bench.get("/index").text)
        wait_until(lambda: "1/1" in plain(bench.get("/runs").text))
        assert call(dataset.cli.main, *folders, "--bins", 5, "a") == 0  # by a person, who chose
        (tmp_path / "sessions" / "a.mcap").unlink()
        write_log(tmp_path / "sessions" / "a.mcap", [0.3] * 400, lambda camera, row: road_jpeg(row))
        wait_until(lambda: "does not have a." in plain(bench.get("/jobs?start=train").text))
        job = bench.post("/jobs", form="train", name="s", epochs="1", network="small").headers["location"]
        assert "bc-index" not in bench.get(job).text


@pytest.mark.parametrize(
    ("changed", "reported"),
    [
        ({"format": 99}, "of format 99, not 5"),
        ({"format": "<b>x"}, "of format <b>x"),
        ({"balance": {}}, "invalid metadata"),
        ({"settings": None}, "invalid metadata"),
    ],
)
def test_an_index_of_another_version_or_hand_is_reported(
    bench: Served, tmp_path: Path, changed: dict[str, object], reported: str
) -> None:
    whole = pq.read_table(bench.folder / "index" / "samples.parquet")
    stored = json.loads(whole.schema.metadata[b"bc.index"])
    metadata = {b"bc.index": json.dumps({**stored, **changed}).encode()}
    (tmp_path / "index").mkdir()
    pq.write_table(whole.replace_schema_metadata(metadata), tmp_path / "index" / "samples.parquet")
    with served(tmp_path) as other:
        answer = other.get("/index")
        assert (answer.status, reported in plain(answer.text)) == (200, True)
        assert "<b>x" not in answer.text
        assert other.get("/index.bins").status == 422


def test_without_an_index_or_with_a_damaged_one_it_reports_so(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        page = bench.get("/index").text
        assert "Nothing prepared yet" in page
        assert "problem" not in page  # it is no error: nothing was built yet
        (tmp_path / "index").mkdir()
        (tmp_path / "index" / "samples.parquet").write_bytes(b"PAR1")
        assert "damaged" in bench.get("/index").text
        assert bench.get("/index.leaks").status == 422
        assert bench.get("/index.bins").status == 422
        assert bench.get("/index.altered").status == 422


def test_a_damaged_index_is_built_anew_by_one_button(tmp_path: Path) -> None:
    write_log(tmp_path / "sessions" / "a.mcap", [0.1] * 400, lambda camera, row: road_jpeg(row))
    (tmp_path / "index").mkdir()
    (tmp_path / "index" / "samples.parquet").write_bytes(b"PAR1")
    with served(tmp_path) as bench:
        assert "Prepare it" in bench.get("/index").text
        bench.post("/jobs", form="index")
        wait_until(lambda: "Train on it" in bench.get("/index").text)
        assert "damaged" not in bench.get("/index").text
