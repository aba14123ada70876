"""A run answers in the steering of its sessions' car, and is neither mixed nor compared with that of another."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from dataset.cli import main as bc_index
from drive.driven_car import driven_car
from drive.evaluation.eval_cli import main as bc_eval
from model.cli import main as bc_train
from model.runs.car_of_run import max_steering_deg_of_run
from model.runs.history import read_history
from recorder import Log
from recorder.log.session_car import Car
from tests.helpers.driving import one_line_in, road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

ROWS = 40
OWN = Car(max_steering_deg=30.0, wheelbase_m=2.4)

SMALL = ("--network", "small", "--epochs", 1, "--batch", 32, "--threads", 1)


def record(name: str, car: Car | None, first: int) -> Path:
    steering = [math.sin(row / 5) for row in range(ROWS)]
    path = Path("sessions") / f"{name}.mcap"
    return write_log(
        path, steering, lambda _, row: road_jpeg(first + row), cameras=["center"], source="udacity", car=car
    )


def index(name: str) -> int:
    return call(bc_index, name, "--index", f"index-{name}", "--block-s", 1, "--gap-s", 0, "--no-balance")


def test_a_run_has_the_steering_and_the_car_of_its_sessions(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record("own", OWN, 0)
    record("plain", None, 100)
    record("known", Car(), 200)
    assert call(bc_index) == 1
    assert "sessions known and own: steering 1 is 25 degrees in one and 30 in the other" in one_line_in(capsys)
    assert not Path("index").exists()
    for name in ("own", "plain"):
        assert index(name) == 0
        assert call(bc_train, "--index", f"index-{name}", "--name", name, *SMALL) == 0
    assert max_steering_deg_of_run(Path("runs/own")) == 30
    assert driven_car(Path("runs/own"), None) == OWN
    assert max_steering_deg_of_run(Path("runs/plain")) == 25
    assert driven_car(Path("runs/plain"), None) is None
    config = json.loads(Path("runs/own/config.json").read_text())
    assert config["data"]["logs"]["own"]["car"]["wheelbase_m"] == 2.4

    capsys.readouterr()
    assert call(bc_eval, "own", "--index", "index-own", "--split", "train", "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    with Log("sessions/own.mcap") as log:
        spread_deg = json.loads(log.read_metadata("bc.quality")["steering"])["spread_deg"]
    assert spread_deg == pytest.approx(30 * np.std([math.sin(row / 5) for row in range(ROWS)]))
    samples = pq.read_table("index-own/samples.parquet").to_pylist()
    driven = [row["recorded"] for row in samples if row["split"] == "train" and not row["flip"]]
    assert printed["zero"]["rmse_deg"] == pytest.approx(30 * np.sqrt(np.mean(np.square(driven))))
    (epoch,) = read_history(Path("runs/own"))[0].epochs
    assert epoch.measures.max_deg == 30
    assert epoch.validation_loss == pytest.approx((epoch.measures.network.rmse_deg / 30) ** 2)
    for line in (
        (bc_eval, "own", "--index", "index-plain"),
        (bc_train, "continue", "own", "--index", "index-plain", "--name", "both", *SMALL),
    ):
        assert call(*line) == 1
        assert "steering 1 turns the wheels by 30 degrees" in capsys.readouterr().err
    assert not Path("runs/both").exists()


def test_an_index_is_made_anew_where_a_session_shows_another_car(cwd: Path) -> None:
    """The rows are the same, and the log is as long: only what it says of its car has changed."""
    labels = []
    for wheelbase_m in (2.4, 2.0, 2.4):
        record("own", Car(wheelbase_m=wheelbase_m), 0).touch()
        assert call(bc_index, "--block-s", 1, "--gap-s", 0) == 0
        labels.append((cwd / "index" / "samples.parquet").read_bytes())
        Path("sessions/own.mcap").unlink()
    assert labels[0] == labels[2] != labels[1]
