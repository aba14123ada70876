"""`--targets`: speed and throttle are learnt beside steering, measured, kept, exported and driven."""

from __future__ import annotations

import contextlib
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from safetensors.numpy import load_file
from torch import nn
from torch.nn import functional

from common.car import Camera
from dataset import DatasetError, IndexConfig, SamplesDataset, build_index, decode, load
from dataset.prediction_targets import TargetName
from model import RunError, TrainConfig, export_onnx, load_pilot, predict_log, train
from model.adam import Adam
from model.evaluation.evaluate import evaluate_runs, evaluate_runs_on_sessions, evaluate_sessions
from model.evaluation.run_comparison import Comparison
from model.runs.history import read_history
from model.runs.network_of_run import network_settings
from model.runs.run_folder import load_config
from model.training.step import training_step
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.toy import TINY
from tests.helpers.udacity import encode

ROWS = 160
STEP_S = 0.1
START_NS = 1_720_880_000_000_000_000
ALL: tuple[TargetName, ...] = ("steering", "speed", "throttle")
QUICK = replace(
    TINY, network="small", targets=ALL, epochs=8, batch=8, rate=1e-3, answers="natural", average_steps=5
)


def steering(row: int) -> float:
    return round(0.8 * math.sin(row / 3), 3)


def speed_mph(time_s: float) -> float:
    """Straight lines, which interpolation between rows gives exactly."""
    return 12.0 + 8.0 * abs(time_s % 4.0 - 2.0)  # 12 .. 28


def road(camera: Camera, row: int) -> bytes:
    """A white post where the steering goes, on a ground that is the brighter the faster it is a second later."""
    picture = np.full((160, 320, 3), round(6 * speed_mph(row * STEP_S + 1.0)), np.uint8)
    middle = round(160 + 130 * steering(row))
    picture[:, middle - 20 : middle + 20] = 255
    return encode(picture)


def write_drive(log: Path, *, start_ns: int = START_NS, knows_speed: bool = True) -> Path:
    with LogWriter(log, {"source": "test"}) as writer:
        for row in range(ROWS):
            time_ns = start_ns + round(row * STEP_S * 1e9)
            writer.picture("center", time_ns, row, road("center", row))
            mph = speed_mph(row * STEP_S) if knows_speed else math.nan
            state = VehicleState(steering=steering(row), throttle=0.5, brake=0.25 * (row % 2), speed_mph=mph)
            writer.vehicle(time_ns, row, state)
    return log


SETTINGS = IndexConfig(
    labels="as-recorded", per_bin=16, max_uses=1, block_s=2.0, gap_s=0.0, alter=("none",), speed_ahead_s=1.0
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`index` of a drive; a run of all targets on it, `run`, and as it was after an epoch, `stopped`."""
    folder = tmp_path_factory.mktemp("targets")
    build_index([write_drive(folder / "drive.mcap")], folder / "index", SETTINGS)
    train(folder / "index", folder / "run", replace(QUICK, epochs=1))
    shutil.copytree(folder / "run", folder / "stopped")
    train(folder / "index", folder / "run", QUICK, resume=True)
    return folder


# Labels


def test_the_speed_to_learn_is_a_seconds_later_in_the_same_stretch(folder: Path) -> None:
    rows = pq.read_table(folder / "index" / "samples.parquet").to_pylist()
    frames = pq.read_table(folder / "index" / "frames" / "drive.parquet").to_pylist()
    split = [frame["split"] for frame in frames]
    rows_with_speed = 0
    for row in rows:
        at = row["row"]
        if split[at : at + 11] == [split[at]] * 11:
            rows_with_speed += 1
            assert row["later_speed_mph"] == pytest.approx(speed_mph(at * STEP_S + 1.0))
        else:
            assert row["later_speed_mph"] is None
        assert row["throttle"] == 0.5 - 0.25 * (at % 2)
    assert 0 < rows_with_speed < len(rows)


def test_labels_come_in_the_order_of_the_targets_and_in_their_units(folder: Path) -> None:
    with load(folder / "index", targets=("steering", "throttle", "speed"), batch=1000) as loader:
        (batch,) = loader.in_order()
    rows = [
        row for row in pq.read_table(folder / "index" / "samples.parquet").to_pylist() if row["split"] == "train"
    ]
    expected = np.array(
        [[row["label"], row["throttle"], (row["later_speed_mph"] or math.nan) / 30] for row in rows]
    )
    expected = expected.astype(np.float32)
    np.testing.assert_array_equal(batch.labels, expected)
    assert (batch.steering == expected[:, 0]).all()
    with contextlib.closing(SamplesDataset(folder / "index", targets=("steering", "speed"))) as samples:
        _, labels = samples[3]
    np.testing.assert_array_equal(labels, expected[3, [0, 2]])


@pytest.mark.parametrize(("others_mph", "is_known"), [("10 20", False), ("10", True)])
def test_a_drive_at_a_slow_set_speed_does_not_show_the_roads_speed(
    tmp_path: Path, others_mph: str, is_known: bool
) -> None:
    """Half of the rows keep to 10 mph, the others are slowed down by a bend."""
    logs = []
    for number, (told_mph, driven_mph) in enumerate([("10", (10.2, 7.0)), (others_mph, (9.0, 7.0))]):
        with LogWriter(tmp_path / f"{number}.mcap", {"source": "simulator", "drive.speed": told_mph}) as writer:
            for row in range(40):
                time_ns = START_NS + round((3600 * number + row * STEP_S) * 1e9)
                writer.picture("center", time_ns, row, road("center", row) + bytes([number]))
                writer.vehicle(time_ns, row, VehicleState(speed_mph=driven_mph[row >= 20], steering=steering(row)))
        logs.append(tmp_path / f"{number}.mcap")
    build_index(logs, tmp_path / "index", replace(SETTINGS, validation_share=0.0, speed_ahead_s=0.0, flip=False))
    table = pq.read_table(tmp_path / "index" / "samples.parquet").to_pylist()
    first = [row for row in table if row["session"] == "0"]
    held, slowed = ([row for row in first if (row["row"] >= 20) == is_late] for is_late in (False, True))
    assert held
    assert {row["later_speed_mph"] is not None for row in held} == {is_known}
    assert {row["later_speed_mph"] for row in slowed} == {7.0}


# Learning


def test_an_unknown_label_changes_nothing_and_each_target_has_its_weight() -> None:
    torch.manual_seed(0)
    network = nn.Sequential(nn.Flatten(), nn.Linear(12, 2))
    pictures, labels = (
        torch.rand(4, 3, 2, 2),
        torch.tensor([[0.5, 1.0], [0.1, math.nan], [0.2, 0.3], [0.0, math.nan]]),
    )
    weight, bias = (parameter.detach().clone().requires_grad_() for parameter in network.parameters())
    answers = functional.linear(pictures.flatten(1), weight, bias)
    expected = (answers[:, 0] - labels[:, 0]).square().sum() + 0.25 * (
        answers[[0, 2], 1] - labels[[0, 2], 1]
    ).square().sum()
    (expected / 4).backward()  # type: ignore[no-untyped-call]

    optimizer = Adam(network.parameters(), 0.0)
    error = training_step(
        network, optimizer, pictures, labels, dtype=torch.float32, micro_batch=3, weights=torch.tensor([1.0, 0.25])
    )
    assert error.item() == pytest.approx(expected.item())
    for ours, theirs in zip(network.parameters(), (weight, bias), strict=True):
        assert ours.grad is not None
        assert theirs.grad is not None
        torch.testing.assert_close(ours.grad, theirs.grad)


def test_speed_is_learnt_and_stands_beside_the_mean(folder: Path) -> None:
    epochs = read_history(folder / "run")[0].epochs
    speed, throttle = epochs[-1].targets
    assert (speed.target, throttle.target) == ("speed", "throttle")
    assert speed.rmse < speed.mean_rmse
    assert speed.correlation > 0.9
    line = json.loads((folder / "run" / "metrics.jsonl").read_text().splitlines()[-1])
    assert line["targets"][0]["unit"] == "mph"


def test_a_run_of_targets_that_was_stopped_goes_on_to_the_same_weights(folder: Path) -> None:
    longer = replace(QUICK, epochs=2)
    train(folder / "index", folder / "stopped", longer, resume=True)
    train(folder / "index", folder / "at-once", longer)
    ours, theirs = (load_file(folder / name / "model.safetensors") for name in ("stopped", "at-once"))
    assert ours["head.5.weight"].shape == (3, 16)
    assert all((ours[name] == theirs[name]).all() for name in ours)


def test_steering_alone_is_learnt_as_if_there_were_no_other_targets(folder: Path, tmp_path: Path) -> None:
    """Its samples are those of an index of the version before, which had no other labels."""
    alone = replace(QUICK, targets=("steering",), epochs=1)
    weights: list[bytes] = []
    for index in (folder / "index", before(folder / "index", tmp_path)):
        run = tmp_path / f"run-{len(weights)}"
        train(index, run, alone)
        assert "targets" not in json.loads((run / "metrics.jsonl").read_text())
        weights.append((run / "model.safetensors").read_bytes())
    assert weights[0] == weights[1]


def before(index: Path, folder: Path) -> Path:
    """The index as format 4 had it."""
    table = pq.read_table(index / "samples.parquet").drop_columns(["later_speed_mph", "throttle"])
    metadata = dict(table.schema.metadata)
    stored = json.loads(metadata[b"bc.index"])
    stored["format"] = 4
    for log in stored["logs"].values():
        log["log"] = str((index / log["log"]).resolve())
    del stored["settings"]["speed_ahead_s"]
    metadata[b"bc.index"] = json.dumps(stored).encode()
    earlier = folder / "before"
    earlier.mkdir()
    pq.write_table(table.replace_schema_metadata(metadata), earlier / "samples.parquet")
    return earlier


# What has learnt them


def test_it_is_measured_compared_exported_and_drives_by_the_same_answers(folder: Path) -> None:
    run = folder / "run"
    pilot = load_pilot(run, "float32")
    assert (pilot.targets, pilot.speed_ahead_s) == (ALL, 1.0)
    (evaluation,) = evaluate_runs([run], folder / "index")
    row = evaluation.frames.to_pylist()[0]
    crop = pilot.crop(decode(road("center", row["row"])))
    answer = pilot.answer(crop)
    assert answer.steering == pilot.predict(crop) == pytest.approx(row["predicted"], abs=1e-5)
    assert answer.speed_mph == pytest.approx(row["predicted_speed_mph"], abs=1e-3)
    assert answer.throttle == pytest.approx(row["predicted_throttle"], abs=1e-5)

    errors = np.array(
        [frame["predicted_speed_mph"] - frame["recorded_speed_mph"] for frame in evaluation.frames.to_pylist()]
    )
    speed = evaluation.other_targets[0]
    assert speed.rmse == pytest.approx(math.sqrt(np.nanmean(errors**2)))
    assert evaluation.as_dict()["targets"][0]["rmse"] == speed.rmse
    names = [difference.measure.name for difference in Comparison(evaluation, evaluation).differences]
    assert names[-2:] == ["speed_mph_rmse", "throttle_rmse"]
    played = predict_log(folder / "drive.mcap", [run])
    assert played.predicted["run"][row["row"]] == pytest.approx(row["predicted"], abs=1e-6)

    import onnxruntime

    assert export_onnx(run, folder / "run.onnx") < 1e-4
    session = onnxruntime.InferenceSession((folder / "run.onnx").read_bytes(), providers=["CPUExecutionProvider"])
    outputs = session.run(["steering", "speed_mph", "throttle"], {"pictures": crop[None]})
    assert [float(values[0]) for values in outputs] == pytest.approx(list(answer), abs=1e-3)


def test_a_worse_speed_makes_a_run_worse(folder: Path) -> None:
    (good,) = evaluate_runs([folder / "run"], folder / "index")
    frames = good.frames
    slow = frames.set_column(
        frames.schema.get_field_index("predicted_speed_mph"),
        "predicted_speed_mph",
        [[value - 5.0 for value in frames["predicted_speed_mph"].to_pylist()]],
    )
    differences = Comparison(good, replace(good, frames=slow)).differences
    worse_by = {difference.measure.name: difference.b - difference.a for difference in differences}
    assert worse_by["rmse_deg"] == 0
    assert worse_by["speed_mph_rmse"] > 2


def test_the_speed_of_another_time_is_not_measured_and_that_is_said(folder: Path, tmp_path: Path) -> None:
    """An index, or a run that is compared with it, may have the speed of another time; its run answers that of a
    second later."""
    build_index([folder / "drive.mcap"], tmp_path / "index", replace(SETTINGS, speed_ahead_s=0.5))
    (evaluation,) = evaluate_runs([folder / "run"], tmp_path / "index")
    assert [errors.target for errors in evaluation.other_targets] == ["throttle"]
    (notice,) = evaluation.notices
    assert "it answers the speed 1 s ahead, and the labels have the speed 0.5 s ahead" in notice

    half = replace(QUICK, targets=("steering", "speed"), epochs=1)
    train(tmp_path / "index", tmp_path / "half", half)
    alone = replace(QUICK, targets=("steering",), epochs=1)
    build_index([folder / "drive.mcap"], tmp_path / "late", replace(SETTINGS, speed_ahead_s=2.0))
    train(tmp_path / "late", tmp_path / "alone", alone)
    by_itself = evaluate_sessions(tmp_path / "half", [folder / "drive.mcap"])
    runs = [tmp_path / "alone", tmp_path / "half", folder / "run"]
    _, second, third = evaluate_runs_on_sessions(runs, [folder / "drive.mcap"])
    assert second.other_targets == by_itself.other_targets
    assert [errors.target for errors in third.other_targets] == ["throttle"]
    assert sum("it answers the speed 1 s ahead" in notice for notice in third.notices) == 1


# What goes on from it


def test_a_training_like_its_own_has_its_targets_and_their_weights(folder: Path, tmp_path: Path) -> None:
    """As `bc-train continue RUN --takeovers LOG` trains."""
    config = load_config(folder / "run")
    config["training"]["target_weights"] = [1.0, 0.5, 0.25]
    settings = replace(TrainConfig(epochs=1), **network_settings(config, folder / "run"))
    assert (settings.targets, settings.target_weights) == (ALL, (1.0, 0.5, 0.25))
    settings = replace(settings, batch=8)
    assert train(folder / "index", tmp_path / "next", settings, init=folder / "run").epochs
    config["training"]["target_weights"] = [-1.0]
    with pytest.raises(RunError, match="training settings cannot be used"):
        network_settings(config, folder / "run")


# What cannot be


def test_pedals_that_are_never_touched_were_not_reported(tmp_path: Path) -> None:
    """As of a ROS bag, which has the steering alone."""
    with LogWriter(tmp_path / "bag.mcap", {"source": "test"}) as writer:
        for row in range(ROWS):
            time_ns = START_NS + round(row * STEP_S * 1e9)
            writer.picture("center", time_ns, row, road("center", row))
            writer.vehicle(time_ns, row, VehicleState(steering=steering(row), speed_mph=math.nan))
    build_index([tmp_path / "bag.mcap"], tmp_path / "index", SETTINGS)
    with pytest.raises(RunError, match="no session has a throttle"):
        train(tmp_path / "index", tmp_path / "run", replace(QUICK, targets=("steering", "throttle")))


def test_a_session_without_speed_is_learnt_for_its_steering_and_named(folder: Path, tmp_path: Path) -> None:
    silent = write_drive(tmp_path / "silent.mcap", knows_speed=False)
    drive = write_drive(tmp_path / "told.mcap", start_ns=START_NS + 3600 * 10**9)
    build_index([silent, drive], tmp_path / "index", SETTINGS)
    settings = replace(QUICK, targets=("steering", "speed"), epochs=1)
    trained = train(tmp_path / "index", tmp_path / "run", settings)
    assert any("no speed in silent, which train only steering" in notice for notice in trained.notices)
    build_index([silent], tmp_path / "index", SETTINGS)
    with pytest.raises(RunError, match="no session has a speed"):
        train(tmp_path / "index", tmp_path / "none", settings)
    assert not (tmp_path / "none").exists()


def test_an_index_of_the_version_before_has_no_labels_of_others(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"format 4, without labels of speed, throttle; run `bc-index` again"):
        train(before(folder / "index", tmp_path), tmp_path / "run", QUICK)


def test_a_run_of_steering_alone_gives_no_weights_to_one_of_speed(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="answers steering speed throttle, and this one steering speed"):
        train(
            folder / "index",
            tmp_path / "run",
            replace(QUICK, targets=("steering", "speed")),
            init=folder / "run",
        )


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"targets": ("speed",)}, "--targets speed: expected steering first"),
        ({"targets": ("steering", "steering")}, "--targets steering steering: expected steering first"),
        ({"targets": ()}, r"--targets \(none\): expected steering first"),
        ({"targets": ("steering", "speed"), "target_weights": (1.0,)}, "one for each of steering, speed"),
        ({"target_weights": (math.nan,)}, "--target-weights: expected numbers of 0 or more"),
        ({"target_weights": (0.0,)}, "--target-weights: expected numbers of 0 or more, not all 0"),
    ],
)
def test_what_makes_no_sense_is_refused(settings: dict[str, tuple[object, ...]], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        TrainConfig(**settings)  # type: ignore[arg-type]
