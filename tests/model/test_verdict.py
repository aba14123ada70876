"""The verdict on a run: what its numbers say of it, and the one thing that is most likely to help."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow.parquet as pq
import pytest

from model import RunError, Verdict, judge
from model.metrics import Measures, measure
from model.runs.advice import advice
from model.runs.answer_scale import AnswerScale
from model.runs.enough_to_drive import EDGES, ON_ONE, STUDY, Hand, drivable, wilson_interval
from model.runs.run_files import keep_result
from model.runs.run_numbers import RunNumbers, run_numbers
from model.runs.training_progress import Epoch
from model.runs.verdict import verdict_of
from recorder.log.session_car import BUILT_IN
from tests.helpers.driving import untrained_run
from tests.helpers.histories import epoch_line
from tests.helpers.repository import ROOT

ERROR = "balanced RMSE and correlation"
"""The study's name of the driving error."""

DRIVERS: Final[dict[Hand, str]] = {"keys": "keyboard", "smooth": "expert"}

RECORDED = np.concatenate([np.zeros(300), np.linspace(-0.6, 0.6, 300)])


def measured(error: float, recorded: np.ndarray[Any, Any] = RECORDED) -> Measures:
    """Errors of a network that is off by so much in turns, to either side."""
    sign = np.where(np.arange(len(recorded)) % 2, 1.0, -1.0)
    return measure(recorded + sign * error, recorded)


def epoch(number: int, error: float, **changed: Any) -> Epoch:
    return Epoch(number, 0.1, 0.1, measured(error), True, 100.0, 100.0, **changed)


def sound(**changed: Any) -> dict[str, Any]:
    """A config with nothing to be mended: two built-in sessions of three cameras, smoothly steered."""
    habits = {"kind": "smooth", "rows": 2000}
    return {
        "training": {"epochs": 10},
        "index": "../../index",
        "data": {
            "logs": {name: {"log": f"../sessions/{name}.mcap", "car": asdict(BUILT_IN)} for name in ("a", "b")},
            "labels": {
                name: {"habits": habits, "plan": {"smooth_s": 0.0, "why": "smooth"}} for name in ("a", "b")
            },
            "counts": {name: {"frames": 6000, "training": 4800, "validation": 1200} for name in ("a", "b")},
            "settings": {"flip": True, "cameras": ["center", "left", "right"]},
            **changed,
        },
    }


ENDED = [epoch(number, 0.1) for number in range(1, 11)]
WEAK = [epoch(number, 0.35) for number in range(1, 11)]
GOOD = [epoch(number, 0.05) for number in range(1, 11)]
LAP = {"track": "lake", "set_speed_mph": 10.0, "interventions": 0, "laps": 1.0}


def scaled(natural: Epoch, learnt_driving_error: float, **learnt: float) -> Epoch:
    """The epoch with answers in the scale of natural driving, and other errors as learnt."""
    errors = replace(natural.measures.network, **learnt)
    return replace(natural, answers=AnswerScale(0.5), learnt=errors, learnt_driving_error=learnt_driving_error)


def numbers(config: dict[str, Any] | None = None, epochs: list[Epoch] = WEAK, **changed: Any) -> RunNumbers:
    return replace(run_numbers(Path("runs/first"), config or sound(), epochs), **changed)


def test_the_two_lines_of_a_good_network() -> None:
    verdict, errors = verdict_of(numbers(epochs=ENDED)), measured(0.1)
    turns = f"on turns (2.50 against {errors.mean.turning_mae_deg:.2f} degrees)"
    driving = f"driving error ({errors.driving_error:.2f} against 2.00)"
    assert verdict.summary.startswith(
        f"better than always predicting the mean: {turns}, {driving}; perhaps enough"
    )
    assert "32 of 32 networks" in verdict.summary
    assert verdict.lines[1].startswith("next: `bc-eval drive first --tracks lake mountain`: a driving error of ")
    assert [error.ratio for error in verdict.beside_mean] == pytest.approx(
        [
            measured(0.1).network.turning_mae_deg / measured(0.1).mean.turning_mae_deg,
            measured(0.1).driving_error / 2,
            measured(0.1).network.rmse_deg / measured(0.1).mean.rmse_deg,
        ]
    )


@pytest.mark.parametrize(("frames", "is_few"), [(81, True), (299, True), (300, False)])
def test_a_verdict_on_few_frames_reports_that_it_is_uncertain(frames: int, is_few: bool) -> None:
    few = measured(0.1, np.linspace(-0.6, 0.6, frames))
    printed = f"; only {frames} frames measured, so these errors are uncertain; "
    for driven in ((), ({"track": "lake", "set_speed_mph": 10.0, "interventions": 0},)):
        summary = verdict_of(numbers(measured=few, drives=driven)).summary
        assert (printed in summary) is ("uncertain" in summary) is is_few


def test_a_network_that_is_worse_than_the_mean_reports_so_first() -> None:
    """Better in two of the three is no excuse."""
    recorded = np.where(RECORDED == 0, 0.0, np.sign(RECORDED) * 0.06)
    predicted = np.where(RECORDED == 0, 0.0, recorded * -0.2)
    worse = measure(predicted, recorded)
    assert worse.network.turning_mae_deg > worse.mean.turning_mae_deg
    verdict = verdict_of(numbers(measured=worse))
    assert verdict.summary.startswith("no better than always predicting the mean: on turns (")
    assert verdict.summary.endswith("; not enough to drive")
    assert (verdict.is_no_better, verdict.in_short) == (True, "no better")
    clean, failed = ({"track": "lake", "set_speed_mph": 10.0, "interventions": times} for times in (0, 2))
    assert verdict_of(numbers(measured=worse, drives=(clean,))).in_short == "drives"
    assert verdict_of(numbers(measured=worse, drives=(failed,))).in_short == "no better"


@pytest.mark.parametrize(
    ("hands", "error", "is_unseen", "expected"),
    [
        ({"keys"}, 1.0, True, True),
        ({"keys"}, 1.0, False, None),  # on rows of drives that it has learnt from, errors are smaller
        ({"keys"}, 1.07, True, None),
        ({"keys"}, 1.1, False, False),
        ({"smooth"}, 0.54, True, True),
        ({"smooth"}, 0.66, True, None),
        ({"smooth"}, 0.71, True, False),
        ({"keys", "smooth"}, 0.9, True, None),  # enough for keys, too much for smooth steering
        (set(), 0.3, True, True),
        (set(), 1.3, False, False),
    ],
)
def test_enough_to_drive(hands: Any, error: float, is_unseen: bool, expected: bool | None) -> None:
    assert drivable(error, hands, is_unseen=is_unseen, recordings=5).is_enough is expected


@pytest.mark.parametrize(
    ("hands", "error", "expected"),
    [
        ({"keys"}, 0.9, None),
        ({"keys"}, 1.43, None),  # of a network that drives all roads of the study
        ({"keys"}, 1.44, False),
        ({"smooth"}, 0.3, None),
        ({"smooth"}, 0.86, None),
        ({"smooth"}, 0.87, False),
        (set(), 1.3, None),  # not too weak for keys
    ],
)
def test_few_recordings_give_no_certain_verdict(hands: Any, error: float, expected: bool | None) -> None:
    for recordings in (1, 4):
        judged = drivable(error, hands, is_unseen=True, recordings=recordings)
        assert judged.is_enough is expected


@pytest.mark.parametrize(
    ("hand", "message"), [("keys", "1.43, those that left from 0.83"), ("smooth", "0.86, those")]
)
def test_the_kind_of_an_unseen_recording_counts(hand: Hand, message: str) -> None:
    assert message in verdict_of(numbers().of_rows(measured(0.1), ["new"], {"new": hand})).summary


def test_the_counts_are_those_of_the_study() -> None:
    rows = pq.read_table(ROOT / "studies" / "which_number.parquet").to_pylist()
    left = Counter[str]()
    for row in rows:
        left[row["network"]] += row["value"] * ((row["kind"], row["measure"]) == ("driven", "interventions"))
    for hand, driver in DRIVERS.items():
        errors = {
            row["network"]: row["value"] for row in rows if (row["where"], row["measure"]) == (driver, ERROR)
        }
        assert len(errors) == 82
        bounds = (0.0, *EDGES[hand], math.inf)
        for band, low, high in zip(STUDY[hand], bounds, bounds[1:], strict=False):
            names = [name for name, error in errors.items() if low <= error < high]
            stayed = sum(not left[name] for name in names)
            assert (band.below, band.networks, band.stayed) == (high, len(names), stayed)
        of_one = [row for row in rows if row["kind"] == "recording" and f"-{driver}-" in row["where"]]
        has_left, has_stayed = (
            [row["value"] for row in of_one if bool(left[row["network"]]) is is_left] for is_left in (True, False)
        )
        assert ON_ONE[hand] == (round(min(has_left), 2), round(max(has_stayed), 2))


def test_wilsons_interval() -> None:
    """As in Wilson's formula worked out by hand for 0 of 10: z² / (n + z²)."""
    low, high = wilson_interval(0, 10)
    assert (low, high) == pytest.approx((0.0, 1.96**2 / (10 + 1.96**2)))
    low, high = wilson_interval(15, 24)
    assert low < 15 / 24 < high


def a_session(**labels: Any) -> dict[str, Any]:
    return {"a": labels, "b": sound()["data"]["labels"]["b"]}


TURNS = replace(measured(0.35), bins=tuple(part for part in measured(0.35).bins if part.high < 0.05))


@pytest.mark.parametrize(
    ("run", "why", "command"),
    [
        (numbers(is_training=True), "is being trained, 10 epochs", "bc-web --open"),
        (
            numbers(sound(labels=a_session(habits={"kind": "smooth", "rows": 2000}, lag={"correlation": -0.8}))),
            "the pictures of a turn the other way than its steering (-0.80",
            "bc-log check sessions/a.mcap",
        ),
        (
            numbers(sound(labels=a_session(habits={"kind": "constant", "rows": 2000}))),
            "the steering of a never changes (2,000 rows)",
            "bc-log check sessions/a.mcap",
        ),
        (numbers(epochs=WEAK[:4]), "stopped after 4 of 10 epochs", "bc-train resume first"),
        (
            numbers(
                epochs=[scaled(weak, 0.4) for weak in WEAK]
            ),
            "as learnt 0.40",
            "bc-train --like first --answers as-learnt",
        ),
        (
            numbers(epochs=[scaled(weak, 0.4) for weak in WEAK], drives=(LAP,)),  # what it does counts more
            "no intervention on the roads it has driven",
            "bc-eval drive first --tracks random:1 random:2",
        ),
        (
            numbers(  # RMSE alone is then worse than the mean's
                sound(logs={"more": {"log": "../sessions/more.mcap"}, "b": {"log": "../sessions/b.mcap"}}),
                epochs=[scaled(epoch(number, 0.2), 0.4, rmse_deg=90.0) for number in range(1, 11)],
            ),
            "recordings of other roads",
            "bc-import ~/recording more-2",
        ),
        (
            numbers(drives=({"track": "lake", "set_speed_mph": 15.0, "interventions": 3},)),
            "3 interventions on lake at 15 mph",
            "bc-drive first --simulator lake --speed 15 --takeover",
        ),
        (
            numbers(epochs=[*WEAK[:9], epoch(10, 0.3)]),
            "still fell in epoch 10",
            "bc-train resume first --epochs 20",
        ),
        (
            numbers(sound() | {"training": {"epochs": 2}}, [WEAK[0], replace(epoch(2, 0.4), is_best=False)]),
            "2 epochs of 39 steps: networks of fewer than 150 steps seldom drive",
            "bc-train resume first --epochs 10",
        ),
        (
            numbers(sound(counts={name: {"frames": 6000, "training": 600} for name in ("a", "b")})),
            "rows of turns to learn from",
            "bc-record more --track random:2",
        ),
        (
            numbers(sound(logs={"a": {"log": "../sessions/a.mcap"}})),
            "one session",
            "bc-import ~/recording more",
        ),
        (
            numbers(sound(settings={"flip": False}), measured=TURNS),
            "0 % of the turns held out go right, and nothing is mirrored",
            "bc-index && bc-train",
        ),
        (numbers(measured=TURNS), "drive the road the other way round", "bc-record more --track random:2"),
        (
            numbers(
                sound(
                    counts={name: {"frames": 6000, "training": 4800} for name in ("a", "b")},
                    settings={"cameras": ["center"]},
                )
            ),
            "the side cameras are left out",
            "bc-index --cameras center left right && bc-train",
        ),
        (
            numbers(
                epochs=[scaled(good, good.measures.driving_error - 0.02) for good in GOOD]
            ),
            "a driving error of 0.15 is small enough to try",
            "bc-eval drive first --tracks lake mountain",
        ),
        (numbers(), "nothing in its numbers stands out", "bc-record more --track random:2"),
    ],
    ids=[
        "being trained", "contradicting", "constant", "unfinished", "natural answers", "natural, but it drives",
        "natural and better",
        "interventions", "still improving", "few steps", "few turns", "one session", "one side",
        "one side mirrored", "side cameras", "answers hardly worse", "nothing",
    ],
)  # fmt: skip
def test_each_rule_names_its_numbers_and_a_command(run: RunNumbers, why: str, command: str) -> None:
    advised = advice(run)
    assert why in advised.why
    assert advised.command == command


@pytest.mark.parametrize(("frames", "is_advised"), [(100, False), (299, False), (300, True)])
def test_natural_answers_are_judged_on_enough_frames(frames: int, is_advised: bool) -> None:
    weak = [replace(of, measures=measured(0.35, np.linspace(-0.6, 0.6, frames))) for of in WEAK]
    judged = advice(numbers(epochs=[scaled(of, 0.4) for of in weak]))
    assert judged.why.startswith("natural answers make it worse") is is_advised


def test_turns_of_an_unseen_session_are_not_counted_as_learnt() -> None:
    """The unseen road has only left bends, and few."""
    straight = np.concatenate([np.zeros(1190), np.full(10, -0.3)])
    unseen = numbers().of_rows(measure(straight + 0.2, straight), ["unseen"])
    assert unseen.is_unseen
    assert advice(unseen) == advice(numbers())


def test_epochs_are_advised_before_rows_also_of_few_turns() -> None:
    """In the study, networks of 220 rows left the road 41 and 53 times after one epoch, and at most twice after
    ten."""
    improving = [*WEAK[:2], epoch(3, 0.3)]
    few, hardly_any = (
        sound(counts={name: {"frames": 6000, "training": frames} for name in ("a", "b")})
        | {"training": {"epochs": 3}}
        for frames in (600, 200)
    )
    assert advice(numbers(few, improving)).command == "bc-train resume first --epochs 10"
    assert advice(numbers(hardly_any, improving)).command == "bc-train resume first --epochs 10"


def test_a_verdict_is_made_of_what_the_folder_holds(tmp_path: Path) -> None:
    run = a_run(tmp_path / "runs" / "first", lambda line: line)
    assert isinstance(judge(run), Verdict)
    keep_result(run, "simulator", {"track": "lake", "set_speed_mph": 10.0, "interventions": 0, "distance_m": 1.0})
    assert judge(run).summary.endswith("has driven 1 track with 0 interventions")
    keep_result(run, "simulator", {"track": "lake", "set_speed_mph": 20.0, "interventions": 1, "distance_m": 1.0})
    assert judge(run).summary.endswith("has driven 1 track in 2 drives with 1 intervention")
    failed = {"interventions": 2, "track": "x", "set_speed_mph": 9}
    assert verdict_of(numbers(epochs=ENDED, drives=(failed,))).in_short == "leaves the road"
    (run / "config.json").write_text("{")
    with pytest.raises(RunError, match=r"config\.json"):
        judge(run)


@pytest.mark.parametrize(
    ("laps", "printed"),
    [((0.03,), "0.03 laps of 1 track"), ((1.0, 0.25), "1.25 laps of 2 tracks"), ((1.0, 1.0), "driven 2 tracks")],
)
def test_a_part_of_a_lap_is_no_driven_track(laps: tuple[float, ...], printed: str) -> None:
    drives = tuple(
        {"track": f"random:{number}", "set_speed_mph": 10.0, "interventions": 0, "laps": of_drive}
        for number, of_drive in enumerate(laps)
    )
    assert f"{printed} with 0 interventions" in verdict_of(numbers(drives=drives)).summary


def test_a_run_of_the_version_before_is_judged_by_what_it_has(tmp_path: Path) -> None:
    """Without the mean's balanced error there is no driving error, until bc-eval measures it."""

    def earlier(line: dict[str, Any]) -> dict[str, Any]:
        del line["mean"]["balanced_rmse_deg"]
        return line

    run = a_run(tmp_path / "runs" / "first", earlier)
    assert judge(run).summary.endswith("its driving error is not kept: `bc-eval` measures it")
    line = epoch_line(2)
    again = {**line, "network": line["validation"], "split": "validation", "index": "index"}
    again["mean"] |= {"balanced_rmse_deg": 30.0}
    keep_result(run, "frames", again)
    assert "driving error (" in judge(run).summary


def test_crashes_held_out_by_an_earlier_version_are_said(
    tmp_path: Path,
) -> None:
    config = sound()
    config["data"]["labels"]["a"]["plan"]["without_crashes"] = True
    config["data"]["counts"]["a"] |= {"crashed": 30}
    assert verdict_of(numbers(config)).summary.endswith(
        "; crashes were held out, too: `bc-eval` measures without them"
    )
    config["data"]["counts"]["a"] |= {"not_measured": 10}
    assert "crashes" not in verdict_of(numbers(config)).summary
    del config["data"]["counts"]["a"]["not_measured"]
    run = a_run(tmp_path / "runs" / "first", lambda line: line)
    (run / "config.json").write_text(json.dumps(json.loads((run / "config.json").read_text()) | config))
    assert "crashes were held out" in judge(run).summary
    line = epoch_line(2)
    of_all = {**line, "network": line["validation"], "split": "validation", "index": "index"}
    driving = {name: of_all[name] for name in ("zero", "mean", "bins")}
    driving |= {"network": of_all["network"] | {"turning_mae_deg": 1.25}}
    driving["mean"] |= {"balanced_rmse_deg": 30.0}
    keep_result(run, "frames", {**of_all, "without_crashes": driving})
    assert "crashes" not in judge(run).summary
    assert "on turns (1.25 against" in judge(run).summary


def a_run(folder: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Path:
    untrained_run(folder)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | sound()))
    lines = [epoch_line(1), epoch_line(2)]
    for line in lines:
        line["mean"]["balanced_rmse_deg"] = 30.0
    (folder / "metrics.jsonl").write_text("".join(json.dumps(change(line)) + "\n" for line in lines))
    return folder


def test_nan_is_no_verdict_of_being_better() -> None:
    constant = measure(np.zeros(10), np.zeros(10))
    assert math.isnan(constant.network.turning_mae_deg)
    assert verdict_of(numbers(measured=constant)).beside_mean == ()


@pytest.mark.parametrize("steering", [0.0, 0.1, 0.25, 1 / 3])
def test_constant_steering_gives_no_error_to_compare(steering: float) -> None:
    """The mean of a hundred times 0.1 is not exactly 0.1, and no error is divided by the difference."""
    constant = measure(np.full(100, steering + 0.2), np.full(100, steering))
    assert constant.mean.rmse_deg == constant.mean_balanced_rmse_deg == 0
    assert constant.driving_error < 10
    verdict = verdict_of(numbers(measured=constant))
    assert verdict.summary == "the measured steering never changes, so its error is unknown"
