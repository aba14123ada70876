"""Two runs compared on the same frames from the page: `bc-eval compare` as a job, its numbers with intervals."""

from __future__ import annotations

import json
import os
from pathlib import Path
from urllib.parse import urlencode

import numpy as np

from tests.helpers.drives import a_drive
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.logs import write_log
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, plain, served
from web.jobs.job_runner import ABOUT, EXIT, OUTPUT
from web.jobs.jobs import Jobs


def measured(**changed: object) -> dict[str, object]:
    """What `bc-eval compare --json` prints, as far as the page is concerned."""
    rmse = {"a": 2.0, "b": 3.0, "difference": 1.0, "low": 0.5, "high": 1.5, "allowed": 0.0, "verdict": "worse"}
    nothing = {
        "a": None,
        "b": 0.5,
        "difference": None,
        "low": None,
        "high": None,
        "allowed": 0,
        "verdict": "unknown",
    }
    return {
        "frames": 1200,
        "blocks": 40,
        "confidence": 0.95,
        "answers_apart_deg": 1.25,
        "measures": {"rmse_deg": rmse, "correlation": nothing},
        "verdict": "worse",
        **changed,
    }


def a_job(bench: Served, printed: str, code: int) -> Path:
    """A comparison of the runs a and b that has ended, as a bc-web of before has left it; its folder."""
    job = Jobs(bench.folder / "cache").folder / "20990101-000000-000000-0000"
    job.mkdir(parents=True, exist_ok=True)
    words = ["bc-eval", "compare", "a", "b", "--json", *(f"--{name}={bench.folder / name}" for name in NAMES)]
    (job / ABOUT).write_text(json.dumps({"words": words, "began": "2099-01-01T00:00:00+00:00", "made": ""}))
    (job / OUTPUT).write_text(printed)
    (job / EXIT).write_text(str(code))
    return job


NAMES = ("runs", "sessions")


def test_the_intervals_stand_beside_one_another(tmp_path: Path) -> None:
    for name in "ab":
        untrained_run(tmp_path / "runs" / name)
    with served(tmp_path) as bench:
        assert "Not compared yet" in bench.get("/runs.compare?a=a&b=b").text
        a_job(bench, f"progress\n{json.dumps(measured())}\n", 1)
        text = plain(bench.get("/runs.compare?a=a&b=b").text)
        sentence = (
            "b is worse than a: its RMSE is 1.00° higher (50%), between 0.50° higher and 1.50° higher, with 95%"
        )
        assert sentence in text
        assert "1,200 frames held out, in 40 blocks; errors in degrees" in text
        assert "RMSE 2.00 3.00 +1.00 +0.50 .. +1.50 worse" in text
        assert "correlation - 0.500 - - unknown" in text
        assert "compare them again" not in text
        os.utime(tmp_path / "runs" / "b" / "model.safetensors", (5e9, 5e9))  # it has learnt since
        assert "compare them again" in bench.get("/runs.compare?a=a&b=b").text
        assert bench.get("/runs.compare?a=a&b=a").status == 422
        assert bench.get("/runs.compare?a=a&b=none").status == 404


def test_a_tie_says_how_much_more_data_would_settle_it(tmp_path: Path) -> None:
    """The interval shrinks with the root of the data: here, it has to be half as wide."""
    for name in "ab":
        untrained_run(tmp_path / "runs" / name)
    rmse = {"a": 2.0, "b": 2.1, "low": -0.1, "high": 0.3, "verdict": "not told apart"}
    with served(tmp_path) as bench:
        for more, units in (
            ("about 10 min more of held-out driving", "blocks"),
            ("120 more recordings", "sessions"),
        ):
            printed = {key: value for key, value in measured().items() if key != "blocks"} | {units: 40}
            printed |= {"measures": {"rmse_deg": rmse}, "verdict": "not told apart"}
            a_job(bench, json.dumps(printed), 0)
            text = plain(bench.get("/runs.compare?a=a&b=b").text)
            assert "b is not shown to be better or worse than a: its RMSE is 0.10° higher (5%), between" in text
            assert "between 0.10° lower and 0.30° higher" in text
            assert f"If they differ as much as here, {more} would settle it." in text


def test_the_newest_drives_on_one_road_are_on_one_map(tmp_path: Path) -> None:
    for name in "ab":
        untrained_run(tmp_path / "runs" / name)
        a_drive(tmp_path / "drives" / f"{name}.mcap", name, track="lake")
    a_drive(tmp_path / "drives" / "elsewhere.mcap", "b", track="mountain")
    with served(tmp_path) as bench:
        wait_until(lambda: "Their newest test drives" in bench.get("/runs.compare?a=a&b=b").text)
        text = bench.get("/runs.compare?a=a&b=b").text
        assert text.count("<polyline") == 2
        assert "elsewhere" not in text


def test_frames_that_a_run_has_learnt_from_are_named(tmp_path: Path) -> None:
    """The verdict on them says little about other frames."""
    for name in "ab":
        untrained_run(tmp_path / "runs" / name)
    with served(tmp_path) as bench:
        a_job(bench, json.dumps(measured(learnt={"a": 1100, "b": 0}, skipped={"x.mcap": 2})), 3)
        text = plain(bench.get("/runs.compare?a=a&b=b").text)
    assert "A has learnt from 1,100 of these frames: on other frames it may be worse" in text
    assert "B has learnt" not in text
    assert "2 pictures left out, because they do not decode" in text


def test_the_button_is_the_command(tmp_path: Path) -> None:
    steering = 0.3 * np.sin(np.arange(300) / 9)
    write_log(tmp_path / "sessions" / "s.mcap", steering.tolist(), lambda camera, row: road_jpeg(row))
    for name in "ab":
        untrained_run(tmp_path / "runs" / name)
    with served(tmp_path) as bench:
        asked = {"a": "a", "b": "b", "session": "s"}
        compared = f"/runs.compare?{urlencode(asked)}"
        answer = bench.post("/runs.compare", **asked)
        assert (answer.status, answer.headers["location"]) == (303, compared)
        wait_until(lambda: "running" not in bench.get(compared).text)
        shown = plain(bench.get(compared).text)
        assert "The predictions of A and B differ by 0.00 degrees" in shown
        assert "300 frames, in 6 blocks" in shown  # 30 s
        assert f"bc-eval compare a b --json --session s --runs={tmp_path / 'runs'}" in shown
        assert bench.get("/runs.compare?a=a&b=b&session=none").status == 404
        jobs = bench.get("/jobs").text.count("<li id=")
        bench.post("/runs.compare", **asked)  # it is known
        assert bench.get("/jobs").text.count("<li id=") == jobs == 1
