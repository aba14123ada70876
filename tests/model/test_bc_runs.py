"""`bc-runs` lists runs beside one another, with what `bc-eval` has measured of them."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from drive.evaluation.eval_cli import main as bc_eval
from model.runs.run_files import keep_result
from model.runs_cli import main as bc_runs
from tests.helpers.driving import untrained_run
from tests.helpers.histories import epoch_line
from tests.helpers.logs import write_log
from tests.helpers.runs import a_run
from tests.helpers.toy import STEERING, road
from tests.helpers.udacity import call


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")


def drive(track: str, interventions: int, speed_mph: float = 10.0) -> dict[str, Any]:
    return {"track": track, "set_speed_mph": speed_mph, "interventions": interventions, "distance_m": 500.0}


def listed(capsys: pytest.CaptureFixture[str], runs: Path, *flags: str) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert call(bc_runs, "--runs", runs, "--json", *flags) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_runs_stand_beside_one_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep_result(a_run(tmp_path, "first"), "simulator", drive("lake", 2))
    assert call(bc_runs, "--runs", tmp_path) == 0
    header, row = (line.split() for line in capsys.readouterr().out.splitlines()[-2:])
    assert " ".join(header) == "run network sessions recipe epoch RMSE balanced r verdict interventions"
    # RMSE 2 of the mean's 4, and on turns 12 of 9; without a balanced RMSE of the mean, as in earlier versions
    assert row[:8] == ["first", "small", "2", "people", "1/2", "0.50", "-", "0.17"]
    assert " ".join(row[8:]) == "no better 10 mph: lake 2"


def test_the_words_of_the_verdict_are_explained_where_they_are_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = a_run(tmp_path, "blind") / "metrics.jsonl"
    blind.write_text(json.dumps(epoch_line(1, frames=0)) + "\n")
    assert call(bc_runs, "--runs", tmp_path) == 0
    printed = capsys.readouterr()
    assert printed.out.split()[-4:] == ["-", "-", "-", "unknown"]
    meaning = "nothing was held out, or no epoch has ended, or the steering held out never changes"
    assert f"unknown: {meaning}" in printed.err.replace("\n", " ")
    assert "no better" not in printed.err
    keep_result(blind.parent, "simulator", drive("lake", 0))
    a_run(tmp_path, "measured")
    assert call(bc_runs, "--runs", tmp_path, "--sort", "name") == 0
    printed = capsys.readouterr()
    assert "- drives" in " ".join(printed.out.split())  # a drive says more than an error
    assert "no better: than always predicting the mean, on turns" in printed.err
    assert "unknown" not in printed.err


def test_a_run_in_its_first_epoch_has_learnt_0_of_those_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (a_run(tmp_path, "first") / "metrics.jsonl").unlink()
    assert call(bc_runs, "--runs", tmp_path) == 0
    assert "people 0 of 3 - -" in " ".join(capsys.readouterr().out.split())


def test_a_supervised_drive_reports_how_many_interventions_are_a_persons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    keep_result(run := a_run(tmp_path, "first"), "simulator", drive("lake", 2))
    for by_person in (7, 2):  # the last one counts
        keep_result(run, "supervised", drive("mountain", 3) | {"by_person": by_person, "laps": 0.5})
    keep_result(run, "supervised", drive("lake", 1))  # without the person's: no supervised drive
    assert call(bc_runs, "--runs", tmp_path) == 0
    row = capsys.readouterr().out.splitlines()[-1]
    assert "10 mph: lake 2; supervised at 10 mph: mountain 3 (2 by a person) in 0.50 laps" in row


def test_a_run_reports_what_network_it_is_and_what_it_answers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = a_run(tmp_path, "quick")
    config = json.loads((run / "config.json").read_text())
    config |= {"network": {"name": "small"}, "targets": ["steering", "speed"]}
    (run / "config.json").write_text(json.dumps(config))
    assert call(bc_runs, "--runs", tmp_path) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[:3] == ["quick", "small", "+speed"]
    (shown,) = listed(capsys, tmp_path)
    assert (shown["network"], shown["targets"]) == ("small", ["steering", "speed"])


def test_the_best_one_comes_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, rmse_deg, interventions in (("a", 3.0, 0), ("bb", 1.0, 5), ("ccc", 2.0, None)):
        run = a_run(tmp_path, name, rmse_deg)
        if interventions is not None:
            keep_result(run, "simulator", drive("lake", interventions))
    assert [run["name"] for run in listed(capsys, tmp_path, "--sort", "name")] == ["a", "bb", "ccc"]
    assert [run["name"] for run in listed(capsys, tmp_path, "--sort", "rmse")] == ["bb", "ccc", "a"]
    # the one that has not driven comes last
    assert [run["name"] for run in listed(capsys, tmp_path, "--sort", "interventions")] == ["a", "bb", "ccc"]


def measured_on(run: Path, logs: dict[str, str], **settings: Any) -> None:
    config = json.loads((run / "config.json").read_text())
    sessions = {name: {"fingerprint": fingerprint} for name, fingerprint in logs.items()}
    config["data"] = {"logs": sessions, "settings": settings}
    (run / "config.json").write_text(json.dumps(config))


def test_networks_measured_on_other_frames_are_marked_and_ranked_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mixed test drive would make the best driver look worst."""
    for number, (name, rmse_deg) in enumerate((("a", 2.0), ("bb", 1.0), ("ccc", 1.5), ("dddd", 0.5))):
        run = a_run(tmp_path, name, rmse_deg)
        measured_on(
            run, {"sunday": "one" if name != "dddd" else "two"}, seed=1 if name == "ccc" else 0, bins=number
        )
        for file in run.iterdir():
            os.utime(file, (number, number))
    by_rmse = [run["name"] for run in listed(capsys, tmp_path, "--sort", "rmse")]
    assert by_rmse == ["dddd", "ccc", "bb", "a"]  # apart by the log, by the seed of its split, and then by errors
    assert call(bc_runs, "--runs", tmp_path, "--sort", "rmse") == 0
    printed = capsys.readouterr()
    lines = [line.split() for line in printed.out.splitlines() if " people " in line]
    assert [(line[0], line[5]) for line in lines] == [("dddd", "A"), ("ccc", "B"), ("bb", "C"), ("a", "C")]
    answers = " ".join(printed.err.split())
    assert "`bc-eval dddd --session NAME` and `bc-eval ccc --session NAME`" in answers.replace(".venv/bin/", "")


def test_a_run_that_holds_nothing_out_has_no_frames_to_compare(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a_run(tmp_path, "measured")
    unmeasured = a_run(tmp_path, "unmeasured")
    measured_on(unmeasured, {"tiny": "three"})
    (unmeasured / "metrics.jsonl").write_text(json.dumps(epoch_line(1, frames=0)) + "\n")
    assert [bool(run["split"]) for run in listed(capsys, tmp_path, "--sort", "name")] == [True, False]
    assert call(bc_runs, "--runs", tmp_path) == 0
    assert "differ" not in capsys.readouterr().err


def test_the_last_drive_of_each_track_and_speed_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = a_run(tmp_path, "first")
    for result in (drive("lake", 7), drive("lake", 1), drive("lake", 3, 20.0), drive("mountain", 0)):
        keep_result(run, "simulator", result)
    (shown,) = listed(capsys, tmp_path)
    assert [kept["result"]["interventions"] for kept in shown["results"]] == [1, 3, 0]


def test_results_of_other_weights_are_not_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = a_run(tmp_path, "first")
    keep_result(run, "simulator", drive("lake", 7))
    weights = untrained_run(tmp_path / "elsewhere" / "run", seed=9) / "model.safetensors"
    weights.replace(run / "model.safetensors")  # as training on does
    (shown,) = listed(capsys, tmp_path)
    assert shown["results"] == []
    assert "lake" in (run / "results.jsonl").read_text()


def test_bc_eval_keeps_what_it_measures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = a_run(tmp_path / "runs", "first")
    log = write_log(tmp_path / "toy.mcap", STEERING[:8], road, cameras=["center"])
    call(bc_eval, "first", "--runs", tmp_path / "runs", "--session", log, "--json")
    measured = json.loads(capsys.readouterr().out)
    (shown,) = listed(capsys, tmp_path / "runs")
    (kept,) = shown["results"]
    assert (kept["way"], kept["result"]["network"]) == ("frames", measured["network"])
    assert run.joinpath("results.jsonl").read_text().count("\n") == 1


def test_each_session_that_was_measured_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = a_run(tmp_path, "first")
    for session, frames in (("monday", 1), ("sunday", 2), ("monday", 3)):
        result = {"index": None, "split": None, "frames": frames, "sessions": {session: {"frames": frames}}}
        keep_result(run, "frames", result)
    (shown,) = listed(capsys, tmp_path)
    assert [kept["result"]["frames"] for kept in shown["results"]] == [3, 2]  # the last one of each


def test_a_damaged_run_is_named_behind_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a_run(tmp_path, "sound")
    (a_run(tmp_path, "broken") / "config.json").write_text("{")
    assert call(bc_runs, "--runs", tmp_path) == 3
    output = capsys.readouterr()
    assert "sound" in output.out
    assert str(tmp_path / "broken" / "config.json") in output.err


def test_a_line_that_was_cut_off_takes_no_other_one_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A disk that was full, or a kill, may leave half a line."""
    run = a_run(tmp_path, "first")
    keep_result(run, "simulator", drive("lake", 0))
    with (run / "results.jsonl").open("a") as stream:
        stream.write('{"measured_at": "2026-')
    keep_result(run, "simulator", drive("mountain", 1))
    (shown,) = listed(capsys, tmp_path)
    assert [kept["result"]["track"] for kept in shown["results"]] == ["lake", "mountain"]


def test_without_runs_it_reports_how_to_begin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a file").touch()
    assert call(bc_runs, "--runs", tmp_path / "a file") == 1
    assert "a file, not a folder; train a run with `bc-train`" in capsys.readouterr().err
    for folder in (tmp_path, tmp_path / "nowhere"):
        assert call(bc_runs, "--runs", folder) == 1
        assert "bc-train" in capsys.readouterr().err
