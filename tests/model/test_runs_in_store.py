"""`--runs s3://BUCKET/runs`: what is done with runs by name, where they are kept in a store."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from common.location import Location
from common.stored_folder import StoredFolder
from model import RunError, find_run
from model.runs.kept_results import keep_result, kept_results
from model.runs.runs_in_store import send_results
from model.runs_cli import main as bc_runs
from tests.helpers.bucket import Bucket
from tests.helpers.driving import one_line_in, untrained_run
from tests.helpers.histories import epoch_line
from tests.helpers.places import Place
from tests.helpers.udacity import call

RUNS = "s3://logs/runs"
LAKE = {"track": "lake", "set_speed_mph": 10.0, "interventions": 1, "distance_m": 500.0}


def a_run(folder: Path, seed: int = 0) -> Path:
    run = untrained_run(folder, seed)
    config = json.loads((run / "config.json").read_text())
    config |= {"training": {"epochs": 2, "recipe": "people"}, "data": {"logs": {"sunday": {}}}}
    (run / "config.json").write_text(json.dumps(config))
    (run / "metrics.jsonl").write_text(json.dumps(epoch_line(1)) + "\n")
    (run / "last").mkdir()
    (run / "last/checkpoint.safetensors").write_bytes(bytes(100_000))
    return run


def sent(bucket: Bucket, run: Path) -> None:
    """Copy a run to the store, as bc-train does."""
    with StoredFolder(bucket.url(f"runs/{run.name}"), run) as folder:
        folder.upload()


def listed(runs: Location | str, capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert call(bc_runs, "--runs", runs, "--json") == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def moved(bucket: Bucket) -> tuple[int, int]:
    """The requests since the last time, and the bytes answered."""
    requests = list(bucket.requests)
    bucket.requests.clear()
    return len(requests), sum(size for _, _, size in requests)


def test_runs_are_listed_without_their_weights_and_nothing_comes_twice(
    bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [a_run(tmp_path / "here" / name, seed) for seed, name in enumerate(("first", "second", "third"))]
    keep_result(runs[0], "simulator", LAKE)
    local = {run["name"]: run for run in listed(tmp_path / "here", capsys)}
    for run in runs:
        sent(bucket, run)
    moved(bucket)
    stored = {run["name"]: run for run in listed(RUNS, capsys)}
    requests, size = moved(bucket)
    assert requests <= 1 + len(runs) * 4
    assert size < 30_000 < (runs[0] / "model.safetensors").stat().st_size
    assert stored.keys() == local.keys()
    for name, run_here in local.items():
        del run_here["folder"]
        assert stored[name].pop("folder") == f"{RUNS}/{name}"
        verdicts = [listing.pop("verdict") for listing in (run_here, stored[name])]  # their advice names the run
        assert verdicts[0]["beside_mean"] == verdicts[1]["beside_mean"]
        assert stored[name] == run_here

    listed(RUNS, capsys)
    assert moved(bucket)[0] == 1
    keep_result(runs[1], "simulator", LAKE)
    sent(bucket, runs[1])
    moved(bucket)
    results = {run["name"]: len(run["results"]) for run in listed(RUNS, capsys)}
    assert results == {"first": 1, "second": 1, "third": 0}
    assert moved(bucket)[0] == 3  # the listing, the record and the new results


def test_results_of_weights_that_are_no_more_are_not_told(
    bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = a_run(tmp_path / "here/night")
    keep_result(run, "simulator", LAKE)
    sent(bucket, run)
    find_run("night", RUNS)  # a copy of the weights as they are now is here
    other = untrained_run(tmp_path / "other", 1)
    shutil.copy(other / "model.safetensors", run / "model.safetensors")
    sent(bucket, run)
    assert [run["results"] for run in listed(RUNS, capsys)] == [[]]


def test_a_run_that_other_programs_have_copied_there_is_listed_alike(
    bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = a_run(tmp_path / "here/night")
    keep_result(run, "simulator", LAKE)
    (run / "last/.lock").touch()
    shutil.copytree(run, bucket.folder / "runs/night")
    (bucket.folder / "runs/notes").mkdir()
    (bucket.folder / "runs/notes/note.txt").write_text("no run")
    (shown,) = listed(RUNS, capsys)
    assert [kept["result"] for kept in shown["results"]] == [LAKE]
    moved(bucket)
    assert listed(RUNS, capsys) == [shown]
    assert moved(bucket)[0] == 1


def test_a_run_that_cannot_be_read_says_so_by_its_url(
    bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a_run(bucket.folder / "runs/good")
    shutil.copytree(bucket.folder / "runs/good", bucket.folder / "runs/bad")
    (bucket.folder / "runs/bad/config.json").write_text("{")
    assert call(bc_runs, "--runs", RUNS) == 3
    assert f"{RUNS}/bad/config.json: cannot be read" in " ".join(capsys.readouterr().err.split())
    assert call(bc_runs, "--runs", "s3://logs/none") == 1
    assert "s3://logs/none: no run in it" in one_line_in(capsys)


def test_a_run_is_found_by_name_or_is_the_newest(place: Place, tmp_path: Path) -> None:
    for number, name in enumerate(("alder", "older", "newer")):
        weights = a_run(tmp_path / "runs" / name, number) / "model.safetensors"
        os.utime(weights, (1e9 + number, 1e9 + number))
    (tmp_path / "runs/begun").mkdir()
    (tmp_path / "runs/begun/config.json").write_text("{}")
    runs = place(tmp_path / "runs")
    for given, name in ((None, "newer"), ("older", "older"), ("older/last", "older/last")):
        folder = tmp_path / "runs" / name
        files = {path.name: path.read_bytes() for path in find_run(given, runs).iterdir() if path.is_file()}
        ours = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        assert {file: data for file, data in files.items() if not file.startswith(".")} == ours
    for wrong, told in (
        ("oldr", "no .*run there .*; did you mean older?"),
        ("begun", "its first epoch is not finished; `bc-train --resume"),
    ):
        with pytest.raises(RunError, match=told):
            find_run(wrong, runs)
    with pytest.raises(RunError, match="no trained run in it"):
        find_run(None, place(tmp_path / "none"))


def test_results_of_two_machines_are_all_kept(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent(bucket, a_run(tmp_path / "here/night"))
    copies = []
    for machine in ("one", "two"):
        monkeypatch.setenv("BC_CACHE", str(tmp_path / machine))
        copies.append((machine, find_run("night", RUNS)))
    for number in range(2):
        for machine, copy in copies:
            monkeypatch.setenv("BC_CACHE", str(tmp_path / machine))
            keep_result(copy, "frames", {"by": machine, "number": number})
            assert send_results(copy)
    expected = [{"by": machine, "number": number} for number in range(2) for machine in ("one", "two")]
    assert [kept.result for kept in kept_results(bucket.folder / "runs/night")[0]] == expected
    # what could not be sent is not lost when the run is brought again
    keep_result(copies[1][1], "frames", {"by": "two", "number": 2})
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "one"))
    keep_result(copies[0][1], "frames", {"by": "one", "number": 2})
    assert send_results(copies[0][1])
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "two"))
    again = find_run("night", RUNS)
    expected += [{"by": "one", "number": 2}, {"by": "two", "number": 2}]
    assert [kept.result for kept in kept_results(again)[0]] == expected
    assert send_results(again)
    assert [kept.result for kept in kept_results(bucket.folder / "runs/night")[0]] == expected


def test_a_kill_while_lines_of_another_machine_come_loses_none_of_ours(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = tmp_path / "ours" / "results", tmp_path / "theirs" / "results"
    rename = os.replace

    def killed(part: Path, path: Path) -> None:
        rename(part, path)
        if path == ours:
            raise SystemExit

    for number in range(2):
        for path in (ours, theirs):
            with StoredFolder(bucket.url("run"), path.parent, line_files=["results"]) as folder:
                folder.download()
                with path.open("a") as stream:
                    stream.write(f"{number} of {path.parent.name}\n")
                if (number, path) == (1, theirs) or number == 0:
                    folder.upload()
    monkeypatch.setattr(os, "replace", killed)
    with StoredFolder(bucket.url("run"), ours.parent, line_files=["results"]) as folder, pytest.raises(SystemExit):
        folder.download()
    monkeypatch.undo()
    assert sorted(ours.read_text().splitlines()) == ["0 of ours", "0 of theirs", "1 of ours", "1 of theirs"]
