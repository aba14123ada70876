"""Balanced samples teach steering that is too hard: a run answers in the scale of natural driving."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.torch import load_file as load_tensors

from dataset import IndexConfig, Loader, Samples, build_index
from dataset.picture_spec import ORIGINAL
from model import RunError, evaluate, load_pilot, train
from model.network.pilotnet import SmallNetwork
from model.onnx_export import export_onnx
from model.runs.answer_scale import MAX_CURVE, MAX_SCALE, MIN_SCALE, AnswerScale
from model.runs.checkpoint import save_checksummed
from model.runs.history import read_history
from model.runs.run_folder import load_answer_scale
from model.training.validation import NaturalFrames
from tests.helpers.logs import write_log
from tests.helpers.toy import SMALL, road

NEARLY_A_QUARTER = 1 / (1 + 3**0.75)  # of two kinds of frames, one thrice as many: three quarters of the way
NATURAL = replace(SMALL, epochs=2, answers="natural")


@pytest.fixture(scope="module")
def natural(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(index, tmp_path_factory.mktemp("runs") / "natural", NATURAL).run


@pytest.fixture(scope="module")
def as_learnt(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("runs") / "as-learnt"
    return train(index, run, replace(NATURAL, answers="as-learnt")).run


def test_the_fit_is_that_of_least_squares() -> None:
    random = np.random.default_rng(0)
    learnt = random.normal(0, 0.4, 500)
    steering = 0.25 * learnt + 0.8 * learnt * np.abs(learnt) + 0.03 + random.normal(0, 0.1, 500)
    fit = AnswerScale.fit(learnt, steering)
    columns = np.stack([learnt, np.ones(500), learnt * np.abs(learnt)], 1)
    expected = np.linalg.solve(columns.T @ columns, columns.T @ steering)  # the normal equations
    assert (fit.scale, fit.offset, fit.curve) == pytest.approx(tuple(expected), abs=1e-9)


@pytest.mark.parametrize(("beside", "offset"), [(0.15, 0.15), (-0.5, -0.2)])
def test_an_offset_is_taken_off_up_to_a_fifth_of_full_lock(beside: float, offset: float) -> None:
    learnt = np.linspace(-1, 1, 101)
    assert AnswerScale.fit(learnt, learnt + beside).offset == pytest.approx(offset)


@pytest.mark.parametrize(
    ("scale", "curve", "bounds"),
    [
        (-3, 0, (MIN_SCALE, 0)),
        (0, 0, (MIN_SCALE, 0)),
        (9, 0, (MAX_SCALE, MAX_CURVE)),
        (0.5, -1, (None, 0)),
        (-0.2, 1.0, (MIN_SCALE, None)),
        (0.5, 9, (None, MAX_CURVE)),
    ],
)
def test_within_bounds_nothing_fits_better(
    scale: float, curve: float, bounds: tuple[float | None, float | None]
) -> None:
    """A network that knows nothing is not turned round, and more of what was learnt is never less of an answer."""
    learnt = np.linspace(-0.7, 0.7, 141)
    steering = scale * learnt + curve * learnt * np.abs(learnt)
    fit = AnswerScale.fit(learnt, steering)
    for value, expected in zip((fit.scale, fit.curve), bounds, strict=True):
        assert expected is None or value == expected
    tried = [
        float(np.square(steering - AnswerScale(a, 0, b).natural(learnt)).sum())
        for a in np.linspace(MIN_SCALE, MAX_SCALE, 39)
        for b in np.linspace(0, MAX_CURVE, 41)
    ]
    assert np.square(steering - fit.natural(learnt)).sum() <= min(tried) + 1e-12


def test_the_run_answers_so_whatever_asks_it(natural: Path, as_learnt: Path, index: Path, tmp_path: Path) -> None:
    """Evaluation of best and last weights, pilot and ONNX: as the same training without the scale, and then the
    scale."""
    for part in ("", "last"):
        answers = load_answer_scale(natural / part)
        assert answers != AnswerScale()
        learnt = evaluate(as_learnt / part, index)
        scaled = evaluate(natural / part, index)
        expected = by_hand(answers, learnt.frames["predicted"].to_numpy())
        assert scaled.frames["predicted"].to_numpy() == pytest.approx(expected, abs=1e-5)
        assert scaled.as_learnt.rmse_deg == pytest.approx(learnt.measures.network.rmse_deg, abs=1e-3)
    assert export_onnx(natural, tmp_path / "natural.onnx") < 1e-5
    with Samples(index) as samples:
        [batch, *_] = Loader(
            samples, samples.driving_view("validation"), batch=1, seen=SmallNetwork.PICTURE
        ).in_order()
    pilots = [load_pilot(run, "float32").predict(batch.pictures[0]) for run in (natural, as_learnt)]
    expected = by_hand(load_answer_scale(natural), np.array(pilots[1]))
    assert pilots[0] == pytest.approx(float(expected), abs=1e-5)


def by_hand(answers: AnswerScale, learnt: NDArray[np.float64]) -> NDArray[np.float64]:
    bent = answers.curve * np.sign(learnt) * learnt**2
    return np.asarray(answers.scale * learnt + bent + answers.offset)


def test_a_run_whose_scale_is_in_its_last_layer_drives_as_it_did(
    as_learnt: Path, index: Path, tmp_path: Path
) -> None:
    """As the version before this one wrote runs, format 2: its weights need nothing more."""
    shutil.copytree(as_learnt, tmp_path / "run")
    path = tmp_path / "run" / "model.safetensors"
    weights = load_tensors(path)
    weights["head.5.weight"], weights["head.5.bias"] = (
        0.5 * weights["head.5.weight"],
        0.5 * weights["head.5.bias"] + 0.1,
    )
    save_checksummed(path, weights, {"epoch": "1", "answer_scale": "0.5", "answer_offset": "0.1"})
    scaled, learnt = (evaluate(run, index).frames["predicted"].to_numpy() for run in (tmp_path / "run", as_learnt))
    assert scaled == pytest.approx(0.5 * learnt + 0.1, abs=1e-5)


def test_both_numbers_are_reported(natural: Path, as_learnt: Path, index: Path) -> None:
    """Epoch by epoch in the run's history, by bc-train, and by bc-eval."""
    scaled, plain = (read_history(run)[0].epochs for run in (natural, as_learnt))
    for epoch, of_plain in zip(scaled, plain, strict=True):
        assert epoch.learnt == of_plain.measures.network == of_plain.learnt
        assert epoch.measures.network != epoch.learnt
        assert epoch.answers != of_plain.answers == AnswerScale()


def test_only_training_frames_show_it_in_the_frequency_of_the_road(tmp_path: Path) -> None:
    """Thirty frames of forty steer +-0.1; balancing leaves as many of them as of the ten at +-0.6. A network that
    answers as the balanced samples are spread is measured nearly against the forty."""
    steering = [0.1, -0.1, 0.1, -0.1, 0.1, -0.1, 0.6, -0.6] * 8
    log = write_log(
        tmp_path / "toy.mcap", steering, lambda camera, row: road("center", row % 40), cameras=["center"]
    )

    config = IndexConfig(flip=False, max_uses=1, validation_share=0, per_bin=5)
    index = build_index([log], tmp_path / "index", config).path
    with Samples(index) as samples:
        balanced = np.abs(samples.of_split("train")["label"].to_numpy())
        assert np.bincount((balanced > 0.3).astype(int)).tolist() == [10, 10]
        frames = NaturalFrames(samples, batch=4, threads=1, picture=ORIGINAL)
        labels = np.concatenate([batch.steering for batch in frames.loader.in_order()])
    assert (np.abs(labels) > 0.3).mean() == pytest.approx(NEARLY_A_QUARTER, abs=0.03)


def test_a_scale_that_no_training_gives_is_refused(natural: Path, tmp_path: Path) -> None:
    path = natural / "model.safetensors"
    run = tmp_path / "run"
    run.mkdir()
    for metadata in ({"natural_scale": "nan"}, {"natural_curve": "-1"}, {"natural_offset": "x"}):
        save_checksummed(run / path.name, load_tensors(path), {"epoch": "1", **metadata})
        with pytest.raises(RunError, match="train the run again"):
            load_answer_scale(run)
