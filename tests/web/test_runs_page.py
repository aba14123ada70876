"""The pages of runs show what `bc-runs` knows of them, and keep up with a training."""

from __future__ import annotations

import base64
import html
import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, urlencode

import numpy as np
import pyarrow.parquet as pq
import pytest

from common.locks import lock
from dataset import IndexConfig, build_index
from model import train
from model.config import TrainConfig
from model.evaluation.predict_log import predict_log
from model.runs.run_files import TRAINING_LOCK, keep_result
from recorder import Log
from tests.helpers.driving import road_jpeg
from tests.helpers.histories import epoch_line, write_lines
from tests.helpers.logs import write_log
from tests.helpers.pages import opened_page
from tests.helpers.runs import a_run
from tests.helpers.toy import SMALL, STEERING, road
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, plain, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

AWKWARD = "a & <b>'é 100%"
CROP = {"session": "sunday", "row": 7, "log_time_ns": 7, "log_time_utc": "then", "recorded_deg": 1.0}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A run that drove, one with other settings, one of another version, one that is damaged."""
    folder = tmp_path_factory.mktemp("bench")
    runs = folder / "runs"
    write_log(folder / "sessions" / "sunday.mcap", [0.1] * 10)
    good = a_run(runs, "good", 2.0, seed=0)
    keep_result(
        good, "simulator", {"track": "lake", "set_speed_mph": 10.0, "interventions": 2, "distance_m": 500.0}
    )
    a_run(runs, AWKWARD, 3.0, seed=1)
    for name, config in (("newer", '{"format": 99}'), ("broken", "{")):
        (runs / name).mkdir()
        (runs / name / "config.json").write_text(config)
    with served(folder) as server:
        wait_until(lambda: "reading" not in server.get("/runs").text)
        yield server


def rows(bench: Served, query: str = "") -> dict[str, str]:
    """The text of each run in the list, by name and in the order of the list."""
    items = re.findall(r"<tr id=.*?</tr>", bench.get(f"/runs{query}").text, re.DOTALL)
    names = [re.findall(r'class="name"[^>]*>(.*?)</a>', row, re.DOTALL)[0] for row in items]
    return {html.unescape(name): plain(row) for name, row in zip(names, items, strict=True)}


def key_of(bench: Served, name: str) -> str:
    keys: list[str] = re.findall(r'href="/runs/([^"]+)"', bench.get("/runs").text)
    return next(key for key in keys if name in page(bench, key))


def page(bench: Served, key: str) -> str:
    return plain(bench.get(f"/runs/{key}").text)


def test_each_run_is_reported_as_bc_runs_tells_it(bench: Served) -> None:
    listed = rows(bench, "?sort=rmse")
    assert list(listed)[:2] == ["good", AWKWARD]  # the best first
    assert set(listed) == {"good", AWKWARD, "newer", "broken"}
    assert "people 2 1/2 0.50" in listed["good"]
    assert "10 mph: lake 2" in listed["good"]
    assert "of format 99" in listed["newer"]
    assert "damaged" in listed["broken"]
    assert list(rows(bench, "?text=good+people")) == ["good"]
    assert "<b>'" not in bench.get("/runs").text


def test_a_run_of_an_index_that_holds_nothing_out_has_no_error(tmp_path: Path) -> None:
    metrics = a_run(tmp_path / "runs", "blind") / "metrics.jsonl"
    metrics.unlink()
    write_lines(metrics, [epoch_line(1, frames=0)])
    with served(tmp_path) as bench:
        wait_until(lambda: "reading" not in bench.get("/runs").text)
        assert "held-out frames none: its error is unknown" in page(bench, "blind")


def test_curves_lie_over_each_other_and_settings_beside(bench: Served) -> None:
    other = key_of(bench, AWKWARD)
    chosen = f"?run=good&run={other}&run=broken&run=none"
    curves = {run["name"]: run for run in bench.get(f"/runs.curves{chosen}").json}
    assert set(curves) == {"good", AWKWARD, "broken"}
    alone = bench.get("/runs.curves?run=good").json
    assert alone[0]["colour"] == curves["good"]["colour"]
    assert len({run["colour"] for run in curves.values()}) == 3
    assert curves["good"]["lines"]["training loss"][0] == [0.4, 0.8, 1.0]  # in epochs
    assert curves["good"]["lines"]["RMSE"] == [[1.0, 2.0], [0.5, pytest.approx(3 / 4.5)]]
    shown = bench.get(f"/runs{chosen}").text
    differing = [plain(row) for row in re.findall(r"<tr><th scope=\"row\">.*?</tr>", shown, re.DOTALL)]
    assert differing == ["training.seed 0 1"]
    assert "cannot be read" in shown
    assert "checked" in bench.get(f"/runs{chosen}").text


def test_a_runs_page_has_its_verdict_and_what_would_help(bench: Served) -> None:
    text = page(bench, "good")
    assert "no better than always predicting the mean: on turns" in text
    assert "has driven 1 track with 2 interventions" in text
    assert "bc-train resume" in text


def test_a_run_links_to_what_it_learnt_from_and_to_its_worst_frames(bench: Served) -> None:
    text = bench.get("/runs/good").text
    assert 'href="/sessions/sunday"' in text
    assert "monday" in text
    assert "/sessions/monday" not in text  # not there
    assert 'used by networks <a href="/runs/' in bench.get("/sessions/sunday/links").text
    assert 'href="/runs/good"' in bench.get("/sessions/sunday/links").text
    assert "another one" in text  # of which there is no index here
    assert "lake" in plain(text)
    assert bench.get("/runs/newer").status == 200
    assert "of format 99" in page(bench, "newer")
    assert bench.get("/runs/none").status == 404
    assert bench.get("/runs/..%2fruns%2fgood").status == 404


def test_what_bc_eval_measured_is_reported_by_session(tmp_path: Path) -> None:
    run = a_run(tmp_path / "runs", "r", 2.0)
    for session, rmse_deg in (("monday", 5.25), ("sunday", 3.5)):
        errors = {"rmse_deg": rmse_deg, "correlation": None}
        keep_result(run, "frames", {"index": None, "network": errors, "sessions": {session: {}}})
    with served(tmp_path) as bench:
        wait_until(lambda: "Measured in drives and on frames" in bench.get("/runs/r").text)
        text = page(bench, "r")
    assert "of monday , rmse deg 5.25" in text
    assert "of sunday , rmse deg 3.5" in text


def test_runs_measured_on_different_frames_are_listed_apart(tmp_path: Path) -> None:
    for name, rmse_deg, seed in (("a", 2.0, 0), ("b", 1.0, 1), ("c", 1.5, 0)):
        config = a_run(tmp_path / "runs", name, rmse_deg) / "config.json"
        stored = json.loads(config.read_text())
        stored["data"]["settings"]["seed"] = seed  # of the split
        config.write_text(json.dumps(stored))
    with served(tmp_path) as bench:
        wait_until(lambda: "0.25" in bench.get("/runs?sort=rmse").text)
        listed = bench.get("/runs?sort=rmse").text
    names = re.findall(r'<a class="name"[^>]*>(\w)</a>', listed)
    marks = re.findall(r"<td>([AB])</td>", listed)
    assert list(zip(names, marks, strict=True)) in (
        [("c", "A"), ("a", "A"), ("b", "B")],  # by which was written last
        [("b", "A"), ("c", "B"), ("a", "B")],
    )
    assert ("--session NAME</code>" in listed, "`" in listed) == (True, False)


def train_again(project: Path, run: str) -> str:
    """The command of the form to which *Train again* leads."""
    with served(project) as bench:
        wait_until(lambda: "Train again" in bench.get(f"/runs/{run}").text)
        (again,) = re.findall(r'href="/jobs\?([^"]*)">Train again', bench.get(f"/runs/{run}").text)
        values = dict(parse_qsl(html.unescape(again)))
        return bench.command(f"/jobs.command?{urlencode({'form': values.pop('start'), **values})}")


def test_train_again_repeats_the_settings_of_the_run(tmp_path: Path) -> None:
    """Left out, a setting would become the default, without a word."""
    flags = {"recipe": "altered", "light": "as-seen", "rate": 3e-4, "picture_px": [64, 48], "crop_rows": [0, 20]}
    flags |= {"answers": "as-learnt", "average_steps": 1, "alter_each_epoch": ["move", "zoom"], "channels": "YUV"}
    run = a_run(tmp_path / "runs", "mine", 2.0, **flags)
    config = json.loads((run / "config.json").read_text())
    config |= {"index": "index-mine", "init": {"run": "first"}}
    (run / "config.json").write_text(json.dumps(config))
    command = train_again(tmp_path, "mine")
    assert command.startswith("bc-train")
    for words in (
        "--light=as-seen",
        "--rate=0.0003",
        "--picture-px 64 48",
        "--on sunday monday",
        "bc-train continue first",
    ):
        assert words in command
    for words in ("--crop-rows 0 20", "--answers=as-learnt", "--average-steps=1", "--alter-each-epoch move zoom"):
        assert words in command
    assert "--channels=YUV" in command


def test_before_training_again_its_page_names_the_logs_that_differ(tmp_path: Path) -> None:
    """Trained for minutes, the network would be compared with one that learnt from other rows."""
    log = write_log(tmp_path / "sessions" / "my drive.mcap", [0.1] * 10)
    with Log(log) as opened:
        logs = {"my drive": {"fingerprint": opened.fingerprint}}
    run = a_run(tmp_path / "runs", "mine")
    config = json.loads((run / "config.json").read_text()) | {"index": "index-mine", "data": {"logs": logs}}
    (run / "config.json").write_text(json.dumps(config))
    with served(tmp_path) as bench:
        printed = "Train again does not use the same data: my drive"
        wait_until(lambda: "Train again" in plain(bench.get("/runs/mine").text))
        assert printed not in plain(bench.get("/runs/mine").text)
        write_log(tmp_path / "other.mcap", [0.2] * 10).replace(log)
        wait_until(lambda: f"{printed} has changed." in plain(bench.get("/runs/mine").text))
        log.unlink()
        wait_until(lambda: f"{printed} is not in these folders." in plain(bench.get("/runs/mine").text))


def a_run_of_takeovers(project: Path, *drives: str, **training: Any) -> None:
    """The run "second", which has learnt from these drives after the run "first"."""
    a_run(project / "runs", "first")
    run = a_run(project / "runs", "second", **asdict(TrainConfig.of("people")) | {"epochs": 3} | training)
    config = json.loads((run / "config.json").read_text())
    config |= {"index": "index-second", "init": {"run": "first"}}
    config["data"] |= {
        "logs": {name: {} for name in ("sunday", "monday", *drives)},
        "settings": {"drives": "takeovers"},
    }
    (run / "config.json").write_text(json.dumps(config))


@pytest.mark.parametrize("drives", [["helped"], ["helped", "helped again"]], ids=len)
def test_train_again_repeats_the_takeovers(tmp_path: Path, drives: list[str]) -> None:
    logs = [str(write_log(tmp_path / "drives" / f"{name}.mcap", [0.1] * 10)) for name in drives]
    a_run_of_takeovers(tmp_path, *drives)
    command = shlex.split(train_again(tmp_path, "second"))
    assert command[: 4 + len(logs)] == ["bc-train", "continue", "first", "--takeovers", *logs]
    assert command[4 + len(logs) :][:2] == ["--epochs=3", "--recipe=people"]
    assert "--on" not in command


@pytest.mark.parametrize(
    ("kept", "training"), [(["helped"], {}), (["helped", "gone"], {"seed": 1})], ids=["gone", "seed"]
)
def test_takeovers_that_the_form_cannot_repeat_are_not_trained_again(
    tmp_path: Path, kept: list[str], training: dict[str, Any]
) -> None:
    """A drive has gone, or the form has no seed."""
    for name in kept:
        write_log(tmp_path / "drives" / f"{name}.mcap", [0.1] * 10)
    a_run_of_takeovers(tmp_path, "helped", "gone", **training)
    with served(tmp_path) as bench:
        wait_until(lambda: "Measure on recordings" in bench.get("/runs/second").text)
        assert "Train again" not in bench.get("/runs/second").text


def test_a_network_of_ones_own_code_is_not_trained_again_there(tmp_path: Path) -> None:
    """The form has only built-in networks: it would train another one."""
    run = a_run(tmp_path / "runs", "mine")
    config = json.loads((run / "config.json").read_text())
    config["network"]["name"] = "mine.py:Net"
    (run / "config.json").write_text(json.dumps(config))
    with served(tmp_path) as bench:
        wait_until(lambda: "Measure on recordings" in bench.get("/runs/mine").text)
        assert "Train again" not in bench.get("/runs/mine").text


def test_worst_frames_are_a_gallery(tmp_path: Path) -> None:
    run = a_run(tmp_path / "runs", "r", 2.0)
    write_log(tmp_path / "sessions" / "sunday.mcap", [0.1] * 10)
    crop = base64.b64encode(road_jpeg(3)).decode()
    frames = [
        {**CROP, "predicted_deg": degrees, "error_deg": degrees - 1, "jpeg": crop} for degrees in (9.0, -5.0)
    ]
    write_lines(run / "worst.jsonl", [{"epoch": 1, "frames": frames}, {"epoch": 2, "frames": frames[:1]}])
    with served(tmp_path) as bench:
        # of its best epoch, once that is known
        wait_until(lambda: "6.0° too far to the left" in bench.get("/runs/r").text)
        text = bench.get("/runs/r").text
        assert "8.0° too far to the right" in text
        assert 'href="/sessions/sunday#row=7&amp;run=' in text
        # 25 degrees are drawn as 60: the sine and cosine of 21.6 degrees, and of 2.4
        assert '<polyline class="predicted" points="64,128 97.1,44.3"/>' in text
        assert '<polyline class="recorded" points="64,128 67.8,38.1"/>' in text
        assert bench.get("/runs/r/worst/1/1.jpg").body == road_jpeg(3)
        assert bench.get("/runs/r/worst/1/2.jpg").status == 404
        assert "6.0°" not in bench.get("/runs/r?epoch=2").text


def test_while_it_learns_its_page_shows_where_it_is_most_wrong(tmp_path: Path) -> None:
    """And no page offers it as if it had learnt all."""
    run = a_run(tmp_path / "runs", "r", 2.0)
    crop = base64.b64encode(road_jpeg(3)).decode()
    frames = [{**CROP, "predicted_deg": -5.0, "recorded_deg": 1.0, "error_deg": -6.0, "jpeg": crop}]
    write_lines(run / "worst.jsonl", [{"epoch": 1, "frames": []}, {"epoch": 2, "frames": frames}])
    (run / TRAINING_LOCK).parent.mkdir()
    with served(tmp_path) as bench, (run / TRAINING_LOCK).open("ab") as stream:
        lock(stream)
        wait_until(lambda: "Where it is most wrong, after epoch 2" in plain(bench.get("/runs/r").text))
        text = plain(bench.get("/runs/r").text)
        assert "Here it would steer 5.0° to the left , and you steered 1.0° to the right" in text
        assert "You can close this page" in text
        assert "It is still learning: until then, it drives and is measured as it was after epoch 1." in text
        assert "r (still learning)" in bench.get("/wheel?driver=run").text
        assert "r is still learning" in bench.get("/jobs?start=drive&run=r").text


def test_errors_and_bias_stand_beside_the_steering_that_was_recorded(tmp_path: Path) -> None:
    a_run(tmp_path / "runs", "r", 2.0)
    with served(tmp_path) as bench:
        wait_until(lambda: "As numbers" in bench.get("/runs/r").text)
        text = bench.get("/runs/r").text
        # of 25 bins over -25 to 25 degrees; after the first epoch, which was kept
        assert "-19.0° -17.0° 10 18.00 -0.50" in plain(text)
        assert "-1.0° 1.0° 90 6.00 -0.50" in plain(text)
        assert re.findall(r'<rect class="predicted" x="([\d.]+)" width', text) == ["12.0", "48.0"]


def test_of_a_car_whose_angle_is_unknown_errors_are_shares_of_full_lock(tmp_path: Path) -> None:
    run = a_run(tmp_path / "runs", "tub", 2.0)
    lines = [{**json.loads(line), "max_deg": None} for line in (run / "metrics.jsonl").read_text().splitlines()]
    (run / "metrics.jsonl").unlink()
    write_lines(run / "metrics.jsonl", lines)
    crop = base64.b64encode(road_jpeg(3)).decode()
    frames = [{**CROP, "predicted_deg": 9.0, "error_deg": 8.0, "jpeg": crop}]
    write_lines(run / "worst.jsonl", [{"epoch": 1, "max_deg": None, "frames": frames}])
    keep_result(run, "frames", {"index": "index", "max_deg": None, "network": {"rmse_deg": 2.5}})
    with served(tmp_path) as bench:
        wait_until(lambda: "32.0 % too far to the right" in bench.get("/runs/tub").text)
        text = page(bench, "tub")
        assert "RMSE 8.00 % (16.00 % of always predicting the mean)" in text
        assert "rmse, % of full lock 10" in text
        assert "°" not in text


def test_a_training_is_seen_live(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        assert "No networks yet" in bench.get("/runs").text
        before = bench.get("/changes").json["runs"]
        run = a_run(tmp_path / "runs", "r", 2.0)
        assert wait_until(lambda: "1/2" in rows(bench).get("r", ""))
        after = bench.get("/changes").json["runs"]
        assert after != before
        write_lines(run / "metrics.jsonl", [epoch_line(3)])
        assert bench.get("/changes").json["runs"] != after
        wait_until(lambda: "3/3" in rows(bench)["r"])
        assert bench.get("/runs.curves?run=r").json[0]["lines"]["RMSE"][0] == [1.0, 2.0, 3.0]


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
