"""`bc-train --light`: whether a network sees the brightness of pictures, and how a run stores it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Final, get_args

import numpy as np
import pytest
import torch
from torch import Tensor

from model import TrainConfig, load_pilot, train
from model.cli import main
from model.config import Light
from model.network.choice import choose_network
from model.network.names import BUILT_IN
from model.network.small import SmallNetwork
from model.runs.run_folder import load_network
from tests.helpers.toy import SMALL
from tests.helpers.udacity import call

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
    line = ["--init", runs / light, *flags, "--index", index, "--runs", tmp_path]
    assert call(main, "--name", "next", *line) == 0
    assert load_network(tmp_path / "next").standardized == (light == "standardized")
    [other] = set(LIGHTS) - {light}
    capsys.readouterr()
    assert call(main, "--name", "other", *line, "--light", other) == 1
    assert f"its network sees pictures with --light {light}; give this flag" in capsys.readouterr().err
