"""Balanced samples teach steering that is too hard: a run answers in the scale of natural driving."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.numpy import load_file
from safetensors.torch import load_file as load_tensors

from common.car import Camera
from dataset import IndexConfig, Loader, Samples, build_index
from dataset.picture_spec import ORIGINAL
from logs import write_log
from model import RunError, evaluate, load_pilot, train
from model.runs.answer_scale import LEAST_SCALE, MOST_SCALE, AnswerScale
from model.runs.checksums import save_checksummed
from model.runs.history import read_history
from model.runs.run_folder import load_answer_scale
from model.training.natural_frequency import NaturalFrames
from toy import STEERING, TINY, road, toy_index

NATURAL = replace(TINY, epochs=2, answers="natural")


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return toy_index(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def natural(index: Path) -> Path:
    train(index, index.parent / "natural", NATURAL, figures=False)
    return index.parent / "natural"


@pytest.fixture(scope="module")
def as_learnt(index: Path) -> Path:
    train(index, index.parent / "as-learnt", replace(NATURAL, answers="as-learnt"), figures=False)
    return index.parent / "as-learnt"


def test_the_fit_is_that_of_least_squares() -> None:
    random = np.random.default_rng(0)
    learnt = random.normal(0, 0.4, 500)
    steering = 0.45 * learnt + 0.03 + random.normal(0, 0.1, 500)
    found = AnswerScale.fit(learnt, steering)
    assert (found.scale, found.offset) == pytest.approx(tuple(np.polyfit(learnt, steering, 1)), abs=1e-12)
    assert found.learnt(found.natural(learnt)) == pytest.approx(learnt, abs=1e-12)


@pytest.mark.parametrize("learnt", [np.zeros(0), np.full(5, 0.3)])
def test_nothing_to_fit_by_leaves_what_was_learnt(learnt: NDArray[np.float64]) -> None:
    assert AnswerScale.fit(learnt, np.linspace(-1, 1, len(learnt))) == AnswerScale(1, 0)


@pytest.mark.parametrize(("slope", "scale"), [(-3, LEAST_SCALE), (0, LEAST_SCALE), (9, MOST_SCALE)])
def test_a_network_that_knows_nothing_is_not_turned_round(slope: float, scale: float) -> None:
    learnt = np.linspace(-0.1, 0.1, 11)
    assert AnswerScale.fit(learnt, slope * learnt).scale == scale


def test_the_run_answers_so_whatever_asks_it(natural: Path, as_learnt: Path, index: Path, tmp_path: Path) -> None:
    """Best and last weights, in evaluation and pilot: the same training without the scale, times the scale."""
    for part in ("", "last"):
        answers = load_answer_scale(natural / part)
        assert answers != AnswerScale()
        learnt = evaluate(as_learnt / part, index)
        found = evaluate(natural / part, index)
        expected = answers.scale * learnt.frames["predicted"].to_numpy() + answers.offset
        assert found.frames["predicted"].to_numpy() == pytest.approx(expected, abs=1e-5)
        assert found.as_learnt.rmse_deg == pytest.approx(learnt.measures.network.rmse_deg, abs=1e-3)
    with Samples(index) as samples:
        [batch, *_] = Loader(samples, samples.driving_view("validation"), batch=1).in_order()
    pilots = [load_pilot(run, "float32").predict(batch.pictures[0]) for run in (natural, as_learnt)]
    answers = load_answer_scale(natural)
    assert pilots[0] == pytest.approx(answers.scale * pilots[1] + answers.offset, abs=1e-5)


def test_what_is_learnt_does_not_depend_on_it(natural: Path, as_learnt: Path) -> None:
    checkpoints = [load_file(run / "last" / "checkpoint.safetensors") for run in (natural, as_learnt)]
    assert checkpoints[0].keys() == checkpoints[1].keys()
    assert all((checkpoints[0][name] == checkpoints[1][name]).all() for name in checkpoints[0])


def test_both_numbers_are_told(natural: Path, as_learnt: Path, index: Path) -> None:
    """Epoch by epoch in the run's history, by bc-train, and by bc-eval."""
    scaled, plain = (read_history(run)[0].epochs for run in (natural, as_learnt))
    for epoch, of_plain in zip(scaled, plain, strict=True):
        assert epoch.learnt == of_plain.measures.network == of_plain.learnt
        assert epoch.measures.network != epoch.learnt
        assert epoch.answers != of_plain.answers == AnswerScale()


def post(camera: Camera, row: int) -> bytes:
    return road(camera, row % len(STEERING))


def test_only_training_frames_tell_it_in_the_frequency_of_the_road(tmp_path: Path) -> None:
    """Thirty frames of forty steer +-0.1; balancing leaves as many of them as of the ten at +-0.6. A network that
    answers as the balanced samples are spread is measured against the forty."""
    steering = [0.1, -0.1, 0.1, -0.1, 0.1, -0.1, 0.6, -0.6] * 8
    log = write_log(
        tmp_path / "toy.mcap", steering, lambda camera, row: road("center", row % 40), cameras=["center"]
    )

    config = IndexConfig(flip=False, max_uses=1, validation_share=0, per_bin=5)
    index = build_index([log], tmp_path / "index", config).path
    with Samples(index) as samples:
        balanced = np.abs(samples.of_split("train")["label"].to_numpy())
        assert np.bincount((balanced > 0.3).astype(int)).tolist() == [10, 10]
        frames = NaturalFrames(samples, batch=4, threads=1, seen=ORIGINAL)
        labels = np.concatenate([batch.steering for batch in frames.loader.in_order()])
    assert (np.abs(labels) > 0.3).mean() == pytest.approx(16 / 64, abs=0.06)


def test_a_scale_that_no_training_gives_is_refused(natural: Path, tmp_path: Path) -> None:
    path = natural / "model.safetensors"
    run = tmp_path / "run"
    run.mkdir()
    for metadata in ({"answer_scale": "nan"}, {"answer_scale": "1e9"}, {"answer_offset": "x"}):
        save_checksummed(run / path.name, load_tensors(path), {"epoch": "1", **metadata})
        with pytest.raises(RunError, match="train the run again"):
            load_answer_scale(run)
