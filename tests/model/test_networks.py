"""`--network`: every network of the toolkit trains, goes on, drives, is looked into and exported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Final, get_args

import cv2
import numpy as np
import pytest
import torch
from safetensors.numpy import load_file
from torch import Tensor

from dataset import Loader, Samples, decode
from dataset.picture_spec import PictureSpec
from model import RunError, TrainConfig, evaluate, export_onnx, load_pilot, predict_log, train
from model.cli import main
from model.config import Light
from model.evaluation.evaluate import evaluate_runs
from model.evaluation.predict import as_input
from model.network.choice import choose_network
from model.network.names import BUILT_IN
from model.network.pilotnet import SmallNetwork, SteeringNetwork
from model.network.visual_backprop import visual_backprop
from model.runs.run_folder import load_network
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.logs import write_log
from tests.helpers.needs import require
from tests.helpers.toy import SMALL, TINY, road
from tests.helpers.udacity import call

SIZES = {"pilotnet": None, "small": None, "resnet18": (64, 48)}
"""As they are, but for the slow one."""


def skip_without_torchvision(name: str) -> None:
    if name == "resnet18":
        require("torchvision")


def settings(name: str) -> TrainConfig:
    skip_without_torchvision(name)
    return replace(
        TINY, network=name, epochs=2, batch=8, picture_px=SIZES[name], answers="natural", average_steps=5
    )


@pytest.fixture(
    scope="module",
    params=["small", *(pytest.param(name, marks=pytest.mark.long) for name in ("pilotnet", "resnet18"))],
)
def run(request: pytest.FixtureRequest, index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trained for an epoch, and then for another."""
    run: Path = tmp_path_factory.mktemp("runs") / request.param
    whole = settings(request.param)
    train(index, run, replace(whole, epochs=1))
    train(index, run, whole, resume=True)
    return run


@pytest.mark.parametrize(
    ("name", "parameters", "picture"),
    [
        ("original", 5_022_327, PictureSpec()),
        ("pilotnet", 252_219, PictureSpec(200, 66, channels="YUV")),  # Bojarski et al. 2016: 250 thousand
        ("small", 81_929, PictureSpec(96, 48)),
        ("resnet18", 11_177_025, PictureSpec(channels="RGB")),  # torchvision: 11,689,512 with 1000 answers
    ],
)
def test_the_networks_of_the_toolkit(name: str, parameters: int, picture: PictureSpec) -> None:
    skip_without_torchvision(name)
    network = choose_network(TrainConfig(network=name))
    assert network.picture == picture
    before = torch.get_rng_state()
    assert network.try_out(picture, torch.device("cpu")) == parameters
    assert torch.equal(torch.get_rng_state(), before)


def test_a_run_that_was_stopped_goes_on_to_the_same_weights(run: Path, index: Path) -> None:
    at_once = train(index, run.parent / f"{run.name}-at-once", settings(run.name)).run
    for file in ("model.safetensors", "last/checkpoint.safetensors"):
        ours, theirs = load_file(run / file), load_file(at_once / file)
        assert ours.keys() == theirs.keys()
        assert all((ours[name] == theirs[name]).all() for name in ours)


@pytest.mark.parametrize("stored", [{}, {"network": "bojarski2016-modified"}], ids=["nothing", "a name"])
def test_a_run_of_before_there_was_a_choice_has_the_original_network(
    stored: dict[str, str], tmp_path: Path
) -> None:
    run = untrained_run(tmp_path / "run", network="original")
    config = json.loads((run / "config.json").read_text())
    del config["network"]
    (run / "config.json").write_text(json.dumps({**config, **stored}))
    assert isinstance(load_network(run), SteeringNetwork)


def test_its_config_reports_which_network_and_what_it_sees(run: Path) -> None:
    config = json.loads((run / "config.json").read_text())
    assert config["network"] == {"name": run.name, "arguments": {}}
    assert config["parameters"] == sum(p.numel() for p in load_network(run).parameters())
    assert config["preprocessing"]["channels"] == {"pilotnet": "YUV", "small": "BGR", "resnet18": "RGB"}[run.name]
    assert config["preprocessing"]["width_px"] == {"pilotnet": "200", "small": "96", "resnet18": "64"}[run.name]


def test_the_pilot_has_trainings_pixels_and_answers_in_both_arithmetics(run: Path, index: Path) -> None:
    exact, rounded = load_pilot(run, "float32"), load_pilot(run, "bfloat16")
    network = load_network(run)
    with Samples(index) as samples:
        frames = samples.driving_view("validation")
        (pictures, *_) = [
            batch.pictures for batch in Loader(samples, frames, batch=4, seen=exact.picture).in_order()
        ]
        rows = frames["row"].to_pylist()[:4]
    with torch.inference_mode():
        expected = network(as_input(pictures)).tolist()
    crops = [exact.crop(decode(road("center", row))) for row in rows]
    assert [exact.predict(crop) for crop in crops] == pytest.approx(expected, abs=1e-4)
    assert [rounded.predict(crop) for crop in crops] == pytest.approx(expected, abs=0.02)


def test_where_it_looks_can_be_seen(run: Path) -> None:
    network = load_network(run)
    height, width, _ = load_pilot(run).picture.shape
    picture = np.zeros((1, height, width, 3), np.uint8)
    picture[:, :, width // 2 : width // 2 + width // 10] = 255
    steering, maps = visual_backprop(network, as_input(picture))
    with torch.inference_mode():
        assert torch.equal(steering, network(as_input(picture)))
    assert maps.shape == (1, height, width)
    assert (float(maps.min()), float(maps.max())) == (0.0, 1.0)


def test_it_is_exported(run: Path, tmp_path: Path) -> None:
    import onnxruntime

    assert export_onnx(run, tmp_path / "network.onnx") < 1e-4
    session = onnxruntime.InferenceSession(tmp_path / "network.onnx", providers=["CPUExecutionProvider"])
    picture = decode(road_jpeg(3))
    cv2.imwrite(str(tmp_path / "picture.png"), picture)
    example = (
        session.get_modelmeta().custom_metadata_map["example"].replace("print(steering)", "said.append(steering)")
    )
    answers: list[float] = []
    code = compile(example.replace("sys.argv[1]", "network").replace("sys.argv[2]", "picture"), "example", "exec")
    exec(code, {"said": answers, "network": tmp_path / "network.onnx", "picture": str(tmp_path / "picture.png")})
    pilot = load_pilot(run, "float32")
    assert answers == pytest.approx([pilot.predict(pilot.crop(picture))], abs=1e-4)


def test_networks_of_different_pictures_are_measured_on_the_same_frames(index: Path, tmp_path: Path) -> None:
    original = untrained_run(tmp_path / "original", network="original")
    small = train(index, tmp_path / "small", replace(settings("small"), epochs=1)).run
    together = evaluate_runs([original, small], index)
    for run, evaluation in zip((original, small), together, strict=True):
        assert evaluation.measures.network == evaluate(run, index).measures.network
    log = write_log(tmp_path / "log.mcap", [0.0, 0.1], lambda _, row: road_jpeg(row), cameras=["center"])
    found_in_log = predict_log(log, [original, small])
    for run in (original, small):
        pilot = load_pilot(run, "float32")
        expected = [pilot.predict(pilot.crop(decode(road_jpeg(row)))) for row in range(2)]
        assert found_in_log.predicted[run.name].tolist() == pytest.approx(expected, abs=1e-5)
        about = found_in_log.about[f"preprocessing.{run.name}.width_px"]
        assert about == str(pilot.picture.width_px)


# What does not go together


def test_a_run_starts_only_from_weights_of_the_same_network_and_pictures(index: Path, tmp_path: Path) -> None:
    original = untrained_run(tmp_path / "original", network="original")
    with pytest.raises(RunError, match=r"its network is original, and small cannot .* give --network original"):
        train(index, tmp_path / "run", settings("small"), init=original)
    red = replace(TINY, channels="RGB")
    with pytest.raises(RunError, match=r"sees 128 x 128 px BGR.* give --picture-px 128 128 .* --channels BGR"):
        train(index, tmp_path / "run", red, init=original)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("flags", "printed", "code"),
    [
        (["--network", "resnet19"], "did you mean resnet18?", 2),
        (["--network", "small", "--picture-px", 20, 20], "cannot take pictures of 20 x 20 px", 1),
        (["--picture-px", 0, 20], "--picture-px and --crop-rows: expected pictures of 8 to 1,024 px", 2),
        (["--crop-rows", 100, 60], "fewer than 160 rows can be cut off", 2),
        (["--network", "small", "--dropout", 0.3], "--dropout 0.3: the network small has none", 2),
        (
            ["--network", "small", "--network-args", "width=3"],
            "small(standardized=True, width=3) fails (TypeError",
            1,
        ),
        (["--network-args", "3"], "--network-args 3: expected NAME=VALUE", 2),
    ],
)
def test_what_cannot_be_trained_is_one_line(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: list[object], printed: str, code: int
) -> None:
    assert call(main, "--index", index, "--runs", tmp_path, *flags) == code
    lines = capsys.readouterr().err.splitlines()
    assert printed in " ".join(lines)
    assert code == 2 or len(lines) == 1
    assert list(tmp_path.iterdir()) == []


LIGHTS: Final[tuple[Light, ...]] = get_args(Light)
NOISE = torch.from_numpy(np.random.default_rng(0).integers(0, 160, (4, 3, 48, 96)).astype(np.float32))


@pytest.fixture(scope="module")
def runs(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    for light in LIGHTS:
        train(index, folder / light, replace(SMALL, epochs=1, light=light))
    return folder


def test_light_hardly_changes_the_answer() -> None:
    torch.manual_seed(0)
    network = SmallNetwork(standardized=True).eval()

    def answers(pictures: Tensor) -> Tensor:
        with torch.inference_mode():
            answer: Tensor = network(pictures)
            return answer

    as_seen, brighter = answers(NOISE), answers(1.3 * NOISE + 40)
    assert brighter.numpy() == pytest.approx(as_seen.numpy(), abs=0.1 * float(as_seen.std()))
    network.standardized = False
    assert (answers(1.3 * NOISE + 40) - answers(NOISE)).abs().max() > as_seen.std()


def test_the_default_recipe_alone_standardizes() -> None:
    lights = [TrainConfig.of(recipe).light for recipe in ("altered", "people", "original")]
    assert lights == ["standardized", "as-seen", "as-seen"]


def test_a_run_keeps_it_wherever_its_network_answers(runs: Path) -> None:
    for light in LIGHTS:
        network = load_network(runs / light)
        assert network.standardized == (light == "standardized")
        crop = np.random.default_rng(0).integers(0, 256, (48, 96, 3), np.uint8)
        with torch.inference_mode():
            expected = float(network(torch.from_numpy(crop).permute(2, 0, 1)[None]))
        assert load_pilot(runs / light, "float32").predict(crop) == pytest.approx(expected, abs=1e-5)


def test_versions_without_it_refuse_the_run(runs: Path) -> None:
    """Their networks have no such argument. A network that sees pictures as they are has none either."""
    stored = [json.loads((runs / name / "config.json").read_text())["network"] for name in LIGHTS]
    assert [network["arguments"] for network in stored] == [{"standardized": True}, {}]


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_built_in_network_has_it(name: str) -> None:
    for light in LIGHTS:
        network = choose_network(TrainConfig(network=name, light=light)).build()
        assert network.standardized == (light == "standardized")


@pytest.mark.parametrize(("light", "recipe"), [("standardized", "people"), ("as-seen", "altered")])
def test_a_training_sees_as_the_run_from_which_it_starts(
    runs: Path, index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], light: Light, recipe: str
) -> None:
    flags = ["--recipe", recipe, "--network", "small", "--epochs", 1, "--threads", 1, "--batch", 6]
    line = ["continue", runs / light, *flags, "--index", index, "--runs", tmp_path]
    assert call(main, *line, "--name", "next") == 0
    assert load_network(tmp_path / "next").standardized == (light == "standardized")
    [other] = set(LIGHTS) - {light}
    capsys.readouterr()
    assert call(main, *line, "--name", "other", "--light", other) == 1
    assert f"its network sees pictures with --light {light}; give this flag" in capsys.readouterr().err
