"""`bc-eval compare A B`: a run that is worse fails, and one that is the same passes."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch import Tensor

from common.car import Camera
from dataset import IndexConfig, build_index
from drive.evaluation.eval_cli import main
from model import TrainConfig, train
from model.evaluation.differences import overall
from model.evaluation.evaluate import evaluate_runs_on_sessions
from model.evaluation.run_comparison import Comparison
from model.runs.run_folder import load_network, save_weights
from tests.helpers.logs import write_log
from tests.helpers.toy import SMALL
from tests.helpers.udacity import call, encode

LEARNT = [round(0.8 * math.sin(row / 3), 3) for row in range(60)]
STEERING = [round(0.7 * math.sin(row / 2 + 1), 3) for row in range(60)]
STEP_NS = 1_000_000_000  # 12 blocks of 5 s
PEOPLE = replace(SMALL, recipe="people", average_steps=TrainConfig.average_steps, answers="natural")
CROP_PX = 320 / 96  # of the camera's picture, a pixel of the network's

SAME = "good: A and B are the same run, which is never worse than itself; give another run as B"

Json = dict[str, Any]
Weights = dict[str, Tensor]


def posts(steering: list[float], shift_px: float = 0.0) -> Callable[[Camera, int], bytes]:
    """A red post where the steering is, and a blue one where its mirror image is."""

    def picture(camera: Camera, row: int) -> bytes:
        shown = np.zeros((160, 320, 3), np.uint8)
        for side, colour in ((1, (0, 40, 255)), (-1, (255, 40, 0))):
            middle = round(160 + 140 * side * steering[row] + shift_px)
            shown[:, max(0, middle - 20) : middle + 20] += np.array(colour, np.uint8)
        return encode(shown)

    return picture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """runs/good, trained; runs/shifted, which went on with pictures that were cut out 5 pixels farther to the
    right than they are for driving; sessions/new, which neither has seen."""
    folder = tmp_path_factory.mktemp("compared")
    write_log(folder / "sessions" / "new.mcap", STEERING, posts(STEERING), cameras=["center"], step_ns=STEP_NS)
    for name, shift_px, config, init in (
        ("good", 0.0, replace(PEOPLE, epochs=14, rate=1e-3), None),
        ("shifted", -5 * CROP_PX, replace(PEOPLE, epochs=5), folder / "runs" / "good"),
    ):
        log = write_log(folder / f"{name}.mcap", LEARNT, posts(LEARNT, shift_px), cameras=["center"])
        settings = IndexConfig(flip=False, max_uses=1, block_s=0.5, gap_s=0)
        index = build_index([log], folder / f"index-{name}", settings).path
        train(index, folder / "runs" / name, config, init=init, show_progress=False)
    return folder


@pytest.fixture
def cwd(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "80")
    return folder


def planted(folder: Path, name: str, change: Callable[[Weights], object]) -> str:
    """A copy of runs/good with other weights."""
    run = folder / "runs" / name
    if not run.exists():
        shutil.copytree(folder / "runs" / "good", run, ignore=shutil.ignore_patterns("last"))
        weights = dict(load_network(run).state_dict())
        change(weights)
        save_weights(run, weights, epoch=1)
    return name


def round_weights(weights: Weights) -> None:
    for tensor in weights.values():
        tensor.copy_((tensor / 0.05).round() * 0.05)


def swap_channels(weights: Weights) -> None:
    weights["features.0.weight"] = weights["features.0.weight"].flip(1).contiguous()


def compared(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, Json, list[str]]:
    """Exit code, the JSON, and the messages."""
    code = call(main, "compare", *arguments, "--json")
    reported = capsys.readouterr()
    (line,) = reported.out.splitlines()
    result: Json = json.loads(line, parse_constant=pytest.fail)
    return code, result, reported.err.splitlines()


def test_a_run_is_no_worse_than_itself(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, result, reported = compared(capsys, "good", "good", "--session", "new")
    assert (code, result["verdict"]) == (0, "not told apart")
    assert reported == [SAME]
    assert (result["frames"], result["blocks"]) == (len(STEERING), 12)
    for measure in result["measures"].values():
        assert measure["a"] == measure["b"]
        assert (measure["low"], measure["high"]) == (0, 0)
    assert result["answers_apart_deg"] == 0


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(lambda folder: planted(folder, "rounded", round_weights), id="weights rounded to 0.05"),
        pytest.param(lambda folder: planted(folder, "swapped", swap_channels), id="channels swapped"),
        pytest.param(lambda folder: "shifted", id="crop shifted by 5 pixels"),
    ],
)
def test_a_planted_regression_fails_and_the_way_back_is_better(
    cwd: Path, capsys: pytest.CaptureFixture[str], plant: Callable[[Path], str]
) -> None:
    name = plant(cwd)
    code, result, _ = compared(capsys, "good", name, "--session", "new", "--gate")
    assert (code, result["verdict"]) == (1, "worse")
    error = result["measures"]["rmse_deg"]
    assert error["verdict"] == "worse"
    assert error["a"] < 3 < 25 * np.std(STEERING) / 3  # a third of that of always the mean: something to lose
    assert abs(error["difference"]) < result["answers_apart_deg"]  # as far as any answers can be from the recorded
    code, result, _ = compared(capsys, name, "good", "--session", "new", "--gate")
    assert (code, result["verdict"]) == (0, "better")


def test_the_measures_are_those_of_each_run_alone(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, result, _ = compared(capsys, "good", "shifted", "--session", "new")
    for side, run in (("a", "good"), ("b", "shifted")):
        assert call(main, run, "--session", "new", "--json") == 0
        alone = json.loads(capsys.readouterr().out)
        expected = {**alone["network"], "balanced_rmse_deg": alone["balanced_rmse_deg"]}
        assert result[side] == run
        for name, measure in result["measures"].items():
            assert measure[side] == pytest.approx(expected[name], rel=1e-6), name
            assert measure["low"] <= measure["difference"] <= measure["high"]


def test_a_tolerance_lets_a_small_regression_pass(folder: Path) -> None:
    a, b = evaluate_runs_on_sessions(
        [folder / "runs" / name for name in ("good", "shifted")], [folder / "sessions" / "new.mcap"]
    )
    in_degrees = [difference for difference in Comparison(a, b).differences if difference.measure.scale is None]
    worst = max(difference.low / difference.a for difference in in_degrees)
    for tolerance, verdict in ((0.0, "worse"), (0.99 * worst, "worse"), (1.01 * worst, "not told apart")):
        assert overall(Comparison(a, b, tolerance).differences) == verdict


def test_of_too_few_blocks_nothing_is_said_but_that(
    cwd: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "short.mcap", STEERING[:25], posts(STEERING), cameras=["center"], step_ns=STEP_NS)
    code, result, _ = compared(capsys, "good", "shifted", "--session", log)
    assert (code, result["verdict"], result["blocks"]) == (3, "unknown", 5)
    assert result["measures"]["rmse_deg"]["low"] is None
    assert call(main, "compare", "good", "shifted", "--session", log) == 3
    assert "at least 6 blocks" in capsys.readouterr().err
    assert compared(capsys, "good", "good", "--session", log)[0] == 0  # the same answers are no worse
    log = write_log(tmp_path / "one.mcap", STEERING[:5], posts(STEERING), cameras=["center"], step_ns=STEP_NS)
    assert call(main, "compare", "good", "shifted", "--session", log) == 3
    assert "5 frames in 1 block of 5 s" in capsys.readouterr().out


def test_the_frames_are_those_that_the_index_of_a_holds_out(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And a run that has learnt from some of them is named: here from pictures of its own index."""
    code, result, reported = compared(capsys, "good", "good")
    assert (code, result["index"], result["split"], reported) == (0, "index-good", "validation", [SAME])
    assert result["learnt"] == {"a": 0, "b": 0}
    code, result, reported = compared(capsys, "good", "shifted", "--index", "index-shifted", "--split", "train")
    assert result["learnt"] == {"a": 0, "b": result["frames"]}
    code, result, reported = compared(capsys, "good", "good", "--session", "good.mcap")
    assert code == 3
    assert [line.split(" of these")[0] for line in reported[1:]] == [
        f"good has learnt from {result['learnt']['a']}"
    ]


def test_the_table_shows_what_the_json_does(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, result, _ = compared(capsys, "good", "shifted", "--session", "new")
    assert call(main, "compare", "good", "shifted", "--session", "new") == 0  # compared; only a gate fails
    shown = capsys.readouterr()
    assert "bc-eval compare good shifted --tracks lake`" in shown.err.splitlines()[-1]
    lines = shown.out.splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.rstrip() for line in lines[:2]] == ["A: good", "B: shifted"]
    assert lines[2].startswith("60 frames in 12 blocks of 5 s")
    error = result["measures"]["rmse_deg"]
    (row,) = (line.split() for line in lines if line.startswith("RMSE"))
    assert row[1:] == [
        f"{error['a']:.2f}",
        f"{error['b']:.2f}",
        *(f"{error['difference']:+.2f}", f"{error['low']:+.2f}", "..", f"{error['high']:+.2f}", "worse"),
    ]
    assert lines[-1].startswith("B is worse than A: RMSE")


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["compare", "good", "shifted", "--worst", 3], "--worst"),
        (["compare", "good", "shifted", "--tolerance", -0.1], "--tolerance -0.1"),
        (["compare", "good", "shifted", "--laps", 2], "--laps: only with --tracks"),
        (["compare", "good", "shifted", "--tracks", "lake", "--session", "new"], "--session: not with --tracks"),
        (["compare", "good"], "B is missing"),
        (["compare", "good", "shiftde"], "did you mean shifted"),
    ],
)
def test_what_cannot_be_compared_is_one_line(
    cwd: Path, capsys: pytest.CaptureFixture[str], flags: list[object], message: str
) -> None:
    assert call(main, *flags) == (1 if "shiftde" in flags else 2)
    reported = capsys.readouterr()
    (line,) = reported.err.splitlines()
    assert message in line
    assert reported.out == ""
