"""Of a car that never said how far its wheels turn, errors are shares of full lock wherever people read them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import onnxruntime
import pytest

from dataset.cli import main as bc_index
from drive.driven_car import other_steering
from drive.evaluation.eval_cli import main as bc_eval
from model.cli import main as bc_train
from model.runs.history import read_history
from recorder import Log
from recorder.log.session_car import Car, known_max_steering_deg
from recorder.log_cli import main as bc_log
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

pytestmark = pytest.mark.usefixtures("exported_once")

ROWS = 40
SMALL = ("--network", "small", "--epochs", 1, "--batch", 32, "--threads", 1)


def record(name: str, source: str, car: Car | None = None) -> Path:
    steering = [math.sin(row / 5) for row in range(ROWS)]
    path = Path("sessions") / f"{name}.mcap"
    return write_log(path, steering, lambda _, row: road_jpeg(row), cameras=["center"], source=source, car=car)


def test_recordings_of_others_have_no_angle_unless_their_car_is_given(cwd: Path) -> None:
    for source in ("donkeycar", "csv", "mcap", "ros2 bag", "lerobot", "gymnasium"):
        for name, car, expected in (("without", None, None), ("with", Car(max_steering_deg=22.0), 22.0)):
            with Log(record(f"{name} {source}", source, car)) as log:
                assert known_max_steering_deg(log) == expected, source
    with Log(record("udacity", "udacity")) as log:
        assert known_max_steering_deg(log) == 25


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a tub's session, and a run that learnt from it."""
    folder = tmp_path_factory.mktemp("tub")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        record("track", "donkeycar")
        assert call(bc_index, "--block-s", 1, "--gap-s", 0, "--no-balance") == 0
        assert call(bc_train, "--name", "first", *SMALL) == 0
    return folder


def test_a_training_counts_in_shares_and_its_files_in_degrees_of_25(
    trained: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(trained)
    assert call(bc_train, "--name", "again", *SMALL) == 0
    printed = capsys.readouterr().out
    (epoch,) = read_history(Path("runs/again"))[0].epochs
    (line,) = Path("runs/again/metrics.jsonl").read_text().splitlines()
    rmse_deg = json.loads(line)["validation"]["rmse_deg"]
    assert (json.loads(line)["max_deg"], epoch.measures.max_deg) == (None, None)
    assert epoch.validation_loss == pytest.approx((rmse_deg / 25) ** 2)
    assert "held out, in % of full lock; always the mean" in printed
    assert f"RMSE {4 * rmse_deg:.2f}, balanced" in printed
    assert "degree" not in printed


def test_an_evaluation_and_a_comparison_are_in_shares(
    trained: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(trained)
    assert call(bc_eval, "first", "--json") == 0
    output = json.loads(capsys.readouterr().out)
    assert output["max_deg"] is None
    assert call(bc_eval, "first", "--worst", 3) == 0
    shown = capsys.readouterr().out
    assert "errors in % of full lock" in shown
    assert f"{4 * output['network']['rmse_deg']:.2f}" in shown
    assert "worst frames, in % of full lock" in shown
    assert call(bc_eval, "compare", "first", "first", "--split", "train") in (0, 1)
    compared = capsys.readouterr().out
    assert "errors in % of full lock" in compared
    assert "their answers are 0.00 % of full lock apart" in compared
    assert "degree" not in shown + compared


def test_a_card_and_a_file_for_others_say_that_the_angle_is_unknown(
    trained: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(trained)
    assert call(bc_train, "export", "first", "--hub", "hub") == 0
    text = Path("hub/README.md").read_text()
    assert "where 1 is full lock, an unknown angle" in text
    assert "in % of full lock, compared with constant predictions" in text
    assert "degrees" not in text
    session = onnxruntime.InferenceSession("hub/model.onnx", providers=["CPUExecutionProvider"])
    stored = session.get_modelmeta().custom_metadata_map
    assert stored["steering"].endswith("1 is full lock, an unknown angle")
    assert "steering.degrees_per_unit" not in stored


def test_the_log_and_a_drive_with_the_run_say_it(
    trained: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(trained)
    monkeypatch.setenv("COLUMNS", "300")
    assert call(bc_log, "info", "sessions/track.mcap") == 0
    assert "%, up to 100.0" in capsys.readouterr().out
    assert "whose largest wheel angle is unknown" in other_steering(Path("runs/first"), None)
