"""The network is the one of the design, training it leaves a run that says where it comes from, and the pilot of
that run sees what training saw."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import statistics
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from torch import nn
from torch.nn import functional

from dataset import DatasetError, IndexConfig, Loader, Samples, build_index, decode
from dataset.preprocess import Image
from logs import plain_read, write_log
from model import Epoch, RunError, TrainConfig, find_run, load_pilot, train
from model.cli import main
from model.measures import constant_errors, errors
from model.network import SteeringNetwork
from model.training import as_input
from recorder import Log
from recorder.topics import Camera
from udacity import call

TINY = TrainConfig(epochs=4, batch=4, rate=2e-4, dropout=0.0, seed=1, precision="float32", threads=1)
STEERING = [round(0.8 * math.sin(row / 3), 3) for row in range(40)]


def road(camera: Camera, row: int) -> bytes:
    """A white post on black, the farther to the right the more the steering: easy to learn."""
    picture = np.zeros((160, 320, 3), np.uint8)
    middle = round(160 + 140 * STEERING[row])
    picture[:, middle - 20 : middle + 20] = 255
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("toy")
    log = write_log(folder / "toy.mcap", STEERING, road, cameras=["center"])
    return build_index([log], folder / "index", IndexConfig(flip=False, max_uses=1, block_s=0.5, gap_s=0)).path


@pytest.fixture(scope="module")
def trained(index: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Epoch]]:
    run = tmp_path_factory.mktemp("runs") / "toy"
    return run, train(index, run, TINY)


# The network


def test_every_layer_has_the_shape_of_the_design() -> None:
    shapes: list[tuple[str, tuple[int, ...]]] = []

    def remember(layer: nn.Module, _: Any, output: torch.Tensor) -> None:
        if not isinstance(layer, nn.ReLU | nn.Dropout):
            shapes.append((type(layer).__name__, tuple(output.shape[1:])))

    network = SteeringNetwork().eval()
    for layer in [*network.features, *network.head]:
        layer.register_forward_hook(remember)
    assert network(torch.zeros(2, 3, 128, 128, dtype=torch.uint8)).shape == (2,)
    assert shapes == [
        ("Conv2d", (24, 124, 124)),
        ("MaxPool2d", (24, 62, 62)),
        ("Conv2d", (36, 58, 58)),
        ("MaxPool2d", (36, 29, 29)),
        ("Conv2d", (48, 25, 25)),
        ("MaxPool2d", (48, 12, 12)),
        ("Conv2d", (64, 10, 10)),
        ("Conv2d", (64, 8, 8)),
        ("Flatten", (4096,)),
        ("Linear", (1164,)),
        ("Linear", (100,)),
        ("Linear", (50,)),
        ("Linear", (10,)),
        ("Linear", (1,)),
    ]


def test_every_layer_has_the_parameters_of_the_design() -> None:
    counts = [
        sum(parameter.numel() for parameter in layer.parameters())
        for layer in SteeringNetwork().modules()
        if isinstance(layer, nn.Conv2d | nn.Linear)
    ]
    convolutions = [(5, 3, 24), (5, 24, 36), (5, 36, 48), (3, 48, 64), (3, 64, 64)]
    dense = list(pairwise([4096, 1164, 100, 50, 10, 1]))
    assert counts == [
        *(size * size * inputs * outputs + outputs for size, inputs, outputs in convolutions),
        *(inputs * outputs + outputs for inputs, outputs in dense),
    ]
    assert sum(counts) == 5_022_327


def test_dropout_stands_before_each_of_the_two_widest_layers() -> None:
    head = list(SteeringNetwork(dropout=0.3).head)
    before = [following for layer, following in pairwise(head) if isinstance(layer, nn.Dropout)]
    assert [layer.out_features for layer in before if isinstance(layer, nn.Linear)] == [1164, 100]
    assert {layer.p for layer in head if isinstance(layer, nn.Dropout)} == {0.3}


def as_in_the_papers_order(network: SteeringNetwork, pictures: torch.Tensor) -> torch.Tensor:
    """Scaled to -1..1, convolution, ReLU, and only then pooling; written out without the network's own forward."""
    x = pictures.float() / 127.5 - 1
    convolutions = [layer for layer in network.features if isinstance(layer, nn.Conv2d)]
    for number, convolution in enumerate(convolutions):
        x = functional.relu(functional.conv2d(x, convolution.weight, convolution.bias))
        if number < 3:
            x = functional.max_pool2d(x, 2)
    x = x.flatten(1)
    *hidden, last = (layer for layer in network.head if isinstance(layer, nn.Linear))
    for layer in hidden:
        x = functional.relu(functional.linear(x, layer.weight, layer.bias))
    return functional.linear(x, last.weight, last.bias)[:, 0]


def test_pooling_before_relu_gives_what_pooling_after_it_gives() -> None:
    torch.manual_seed(1)
    network = SteeringNetwork().eval()
    for parameter in network.parameters():
        if parameter.dim() > 1:  # lively weights, so that pictures differ in their steering
            nn.init.kaiming_uniform_(parameter, nonlinearity="relu")
    pictures = torch.randint(0, 256, (3, 3, 128, 128), dtype=torch.uint8)
    with torch.inference_mode():
        steering = network(pictures)
        torch.testing.assert_close(steering, as_in_the_papers_order(network, pictures), rtol=1e-4, atol=1e-4)
    assert steering.std() > 1e-3


def test_the_loaders_pictures_are_the_networks_input_without_a_copy() -> None:
    pictures = np.arange(2 * 128 * 128 * 3, dtype=np.uint32).astype(np.uint8).reshape(2, 128, 128, 3)
    inputs = as_input(pictures)
    assert inputs.shape == (2, 3, 128, 128)
    assert inputs.data_ptr() == pictures.ctypes.data
    assert inputs.is_contiguous(memory_format=torch.channels_last)
    assert inputs[1, 2, 5, 7].item() == pictures[1, 5, 7, 2]


# Measures


def test_errors_are_the_formulas() -> None:
    predicted, recorded = [0.0, 0.1, -0.2, 0.04], [0.0, 0.2, -0.4, 0.0]
    off_deg = [25 * (p - r) for p, r in zip(predicted, recorded, strict=True)]  # 0, -2.5, 5, 1
    found = errors(np.array(predicted), np.array(recorded))
    assert found.mae_deg == pytest.approx(8.5 / 4)
    assert found.rmse_deg == pytest.approx(math.sqrt(sum(x * x for x in off_deg) / 4))
    assert found.turning_mae_deg == pytest.approx((2.5 + 5) / 2)
    assert found.correlation == pytest.approx(statistics.correlation(predicted, recorded))


def test_the_mean_is_the_best_constant_and_has_no_correlation() -> None:
    recorded = np.array(STEERING)
    mean = constant_errors(float(recorded.mean()), recorded)
    assert mean.rmse_deg == pytest.approx(25 * statistics.pstdev(STEERING))
    assert mean.rmse_deg < constant_errors(0.0, recorded).rmse_deg
    assert mean.rmse_deg < constant_errors(float(recorded.mean()) + 0.01, recorded).rmse_deg
    assert math.isnan(mean.correlation)


def test_where_nothing_can_be_measured_is_nan() -> None:
    nothing = errors(np.zeros(0), np.zeros(0))
    assert all(map(math.isnan, (nothing.mae_deg, nothing.rmse_deg, nothing.turning_mae_deg, nothing.correlation)))
    assert math.isnan(errors(np.array([0.1]), np.array([0.0])).turning_mae_deg)


# Training


def test_the_loss_falls_and_beats_knowing_nothing(trained: tuple[Path, list[Epoch]]) -> None:
    _, history = trained
    assert [epoch.epoch for epoch in history] == [1, 2, 3, 4]
    assert history[-1].training_loss < 0.8 * history[0].training_loss
    assert history[-1].training_loss < statistics.pvariance(STEERING)


def test_the_weights_can_be_read_by_safetensors_alone(trained: tuple[Path, list[Epoch]]) -> None:
    with safe_open(trained[0] / "model.safetensors", framework="np") as weights:
        tensors = {name: weights.get_tensor(name) for name in weights.keys()}  # noqa: SIM118
    assert sum(tensor.size for tensor in tensors.values()) == 5_022_327
    assert {tensor.dtype for tensor in tensors.values()} == {np.dtype(np.float32)}
    assert all(np.isfinite(tensor).all() for tensor in tensors.values())


def test_the_run_says_where_it_comes_from(trained: tuple[Path, list[Epoch]], index: Path) -> None:
    run, _ = trained
    config = json.loads((run / "config.json").read_text())
    assert config["format"] == 1
    assert config["parameters"] == 5_022_327
    assert config["preprocessing"]["channels"] == "BGR"
    assert (config["preprocessing"]["crop_top"], config["preprocessing"]["crop_bottom"]) == ("50/160", "20/160")
    told = {
        name: config["training"][name] for name in ("epochs", "batch", "rate", "dropout", "seed", "arithmetic")
    }
    assert told == {"epochs": 4, "batch": 4, "rate": 2e-4, "dropout": 0.0, "seed": 1, "arithmetic": "float32"}
    assert config["versions"].keys() >= {"python", "torch", "numpy", "opencv"}
    assert config["versions"]["torch"] == torch.__version__
    assert config["versions"]["opencv"].startswith(cv2.__version__)
    with Log(index.parent / "toy.mcap") as log:
        assert config["data"]["logs"]["toy"]["fingerprint"] == log.fingerprint
    assert len(bytes.fromhex(config["data"]["fingerprint"])) == 32
    assert config["data"]["settings"]["seed"] == 0
    assert {path.name for path in run.iterdir()} >= {"config.json", "metrics.jsonl", "model.safetensors"}
    assert not list(run.glob("*.part"))


def test_metrics_are_one_line_an_epoch(trained: tuple[Path, list[Epoch]]) -> None:
    run, history = trained
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [line["epoch"] for line in lines] == [1, 2, 3, 4]
    assert [line["training_loss"] for line in lines] == [epoch.training_loss for epoch in history]
    assert [line["validation"]["rmse_deg"] for line in lines] == [epoch.validation.rmse_deg for epoch in history]


def test_validation_is_of_the_pictures_that_were_held_out(trained: tuple[Path, list[Epoch]], index: Path) -> None:
    """Recomputed from the files: weights, JPEGs and labels."""
    run, history = trained
    pilot = load_pilot(run)
    samples = Samples(index)
    samples.close()
    held_out = [row for row in samples.table.to_pylist() if row["split"] == "validation"]
    assert held_out
    off = [
        25 * (pilot.predict(pilot.crop(decode(road("center", row["row"])))) - STEERING[row["row"]])
        for row in held_out
    ]
    assert history[-1].validation.mae_deg == pytest.approx(statistics.fmean(map(abs, off)), rel=1e-3)
    recorded = [STEERING[row["row"]] for row in held_out]
    assert history[-1].mean.rmse_deg == pytest.approx(25 * statistics.pstdev(recorded))
    assert history[-1].zero.mae_deg == pytest.approx(25 * statistics.fmean(map(abs, recorded)))


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(
    trained: tuple[Path, list[Epoch]], index: Path, tmp_path: Path
) -> None:
    one_epoch = {"epochs": 1, "batch": 8, "precision": "float32", "threads": 1}

    def weights(name: str, seed: int) -> bytes:
        train(index, tmp_path / name, TrainConfig(seed=seed, **one_epoch))  # type: ignore[arg-type]
        return (tmp_path / name / "model.safetensors").read_bytes()

    first = weights("a", 1)
    assert weights("b", 1) == first
    assert weights("c", 2) != first


def test_other_data_has_another_fingerprint(
    trained: tuple[Path, list[Epoch]], index: Path, tmp_path: Path
) -> None:
    def fingerprint(run: Path) -> str:
        found: str = json.loads((run / "config.json").read_text())["data"]["fingerprint"]
        return found

    log = write_log(tmp_path / "toy.mcap", STEERING[:4], road, cameras=["center"])
    other = build_index([log], tmp_path / "index", IndexConfig(flip=False, max_uses=1, validation_share=0.0)).path
    [epoch] = train(other, tmp_path / "run", TrainConfig(epochs=1, batch=4, precision="float32", threads=1))
    assert math.isnan(epoch.validation.mae_deg)  # nothing was held out
    assert fingerprint(tmp_path / "run") != fingerprint(trained[0])


def test_a_run_that_exists_is_refused_and_stays(trained: tuple[Path, list[Epoch]], index: Path) -> None:
    run, _ = trained
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    with pytest.raises(RunError, match="exists already"):
        train(index, run, TINY)
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_training_without_an_index_leaves_no_run(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="`bc-index`"):
        train(tmp_path / "index", tmp_path / "run", TINY)
    assert list(tmp_path.iterdir()) == []


def test_bc_train_builds_the_index_and_prints_each_epoch(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["--index", tmp_path / "index", "--sessions", index.parent, "--runs", tmp_path / "runs"]
    flags = ["--name", "first", "--epochs", 1, "--batch", 64, "--threads", 1]
    assert call(main, *line, *flags) == 0
    told = capsys.readouterr()
    assert "5,022,327 parameters" in told.out
    assert "epoch  1: training loss 0." in told.out
    assert "always the mean" in told.out
    assert "no index yet" in told.err
    assert find_run(None, tmp_path / "runs") == tmp_path / "runs" / "first"
    assert call(main, *line, *flags) == 1
    assert "first: this run exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    "bad", [{"epochs": 0}, {"batch": 0}, {"rate": 0.0}, {"rate": math.nan}, {"dropout": 1.0}, {"seed": -1}]
)
def test_settings_that_make_no_sense_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        TrainConfig(**bad)


# Runs and pilots


def edit(path: Path, **values: Any) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))


def cut_weights(run: Path) -> None:
    weights = run / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1000])


def no_weights(run: Path) -> None:
    (run / "model.safetensors").unlink()


def garbage_weights(run: Path) -> None:
    (run / "model.safetensors").write_bytes(b"garbage" * 100)


def other_weights(run: Path) -> None:
    save_file({"weight": np.zeros((3, 3), np.float32)}, run / "model.safetensors")


def one_other_shape(run: Path) -> None:
    weights = load_file(run / "model.safetensors")
    name = next(name for name, tensor in weights.items() if tensor.shape == (1, 10))
    save_file({**weights, name: np.zeros((1, 11), np.float32)}, run / "model.safetensors")


def no_config(run: Path) -> None:
    (run / "config.json").unlink()


def garbage_config(run: Path) -> None:
    (run / "config.json").write_bytes(b"\xff{")


def newer_format(run: Path) -> None:
    edit(run / "config.json", format=2)


def other_preprocessing(run: Path) -> None:
    edit(run / "config.json", preprocessing={"channels": "RGB"})


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (cut_weights, r"model\.safetensors: cannot be read"),
        (no_weights, r"model\.safetensors: cannot be read"),
        (garbage_weights, r"model\.safetensors: cannot be read"),
        (other_weights, r"model\.safetensors: weights of another network"),
        (one_other_shape, r"model\.safetensors: weights of another network"),
        (no_config, r"config\.json: cannot be read"),
        (garbage_config, r"config\.json: cannot be read"),
        (newer_format, r"config\.json: of format 2"),
        (other_preprocessing, r"config\.json: trained with another preprocessing"),
    ],
)
def test_a_damaged_run_is_a_run_error_that_names_the_file(
    trained: tuple[Path, list[Epoch]], tmp_path: Path, damage: Callable[[Path], None], says: str
) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained[0], run)
    damage(run)
    with pytest.raises(RunError, match=says) as caught:
        load_pilot(run)
    assert "\n" not in str(caught.value)


def test_a_run_is_found_by_name_by_path_and_as_the_newest(
    trained: tuple[Path, list[Epoch]], tmp_path: Path
) -> None:
    run, _ = trained
    assert find_run("toy", run.parent) == run
    assert find_run(str(run), tmp_path) == run
    assert find_run(None, run.parent) == run
    with pytest.raises(RunError, match="`bc-train`"):
        find_run(None, tmp_path)
    with pytest.raises(RunError, match="other: no trained run"):
        find_run("other", run.parent)


def test_a_pilot_says_the_same_of_the_same_picture_and_which_weights_it_has(
    trained: tuple[Path, list[Epoch]],
) -> None:
    run, _ = trained
    pilots = [load_pilot(run), load_pilot(run)]
    pictures = [decode(road("center", row)) for row in (0, 5)]
    said = [[pilot.predict(pilot.crop(picture)) for picture in (*pictures, *pictures)] for pilot in pilots]
    assert said[0] == said[1]
    assert said[0][:2] == said[0][2:]
    assert said[0][0] != said[0][1]
    assert pilots[0].weights_sha256 == hashlib.sha256((run / "model.safetensors").read_bytes()).hexdigest()
    assert pilots[0].run == "toy"


def test_driving_sees_the_same_pixels_as_training(trained: tuple[Path, list[Epoch]], index: Path) -> None:
    pilot = load_pilot(trained[0])
    samples = Samples(index)
    try:
        loader = Loader(samples, samples.table, batch=16)
        learnt: list[Image] = [picture for batch in loader.in_order() for picture in batch.pictures]
    finally:
        samples.close()
    for row, picture in zip(samples.table.to_pylist(), learnt, strict=True):
        jpeg = plain_read(index.parent / "toy.mcap", row["offset"], row["length"])
        assert jpeg == road("center", row["row"])
        assert (pilot.crop(decode(jpeg)) == picture).all()
