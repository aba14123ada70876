"""Runs and drives in a store: what is measured of a run is kept there."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.stored_folder import StoredFolder
from drive.cli import main as drive_main
from drive.drive_server import DriveServer
from drive.evaluation.eval_cli import main as bc_eval
from model.runs.kept_results import kept_results
from tests.helpers.bucket import Bucket, serving_bucket
from tests.helpers.driving import untrained_run
from tests.helpers.logs import write_log
from tests.helpers.serving import fields
from tests.helpers.toy import STEERING, road
from tests.helpers.udacity import call

RUNS, DRIVES = "s3://logs/runs", "s3://logs/drives"


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    on_machine("one", tmp_path, monkeypatch)
    with serving_bucket(tmp_path / "server", monkeypatch) as served:
        yield served


def on_machine(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / name)
    monkeypatch.setenv("BC_CACHE", str(tmp_path / name / "cache"))


def test_what_is_measured_of_a_run_is_kept_where_the_run_is(
    bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with StoredFolder(bucket.url("runs/night"), untrained_run(tmp_path / "here/night")) as folder:
        folder.upload()
    write_log(Path("sessions/one.mcap"), STEERING[:30], road)
    measured = "night", "--runs", RUNS, "--session", "one", "--json"
    assert call(bc_eval, *measured) == 3  # untrained: it does not say what it has learnt from
    assert [kept.way for kept in kept_results(bucket.folder / "runs/night")[0]] == ["frames"]

    bucket.answer = lambda handler: handler.command == "PUT" and bool(handler.fail(403, "AccessDenied"))
    capsys.readouterr()
    assert call(bc_eval, *measured) == 3
    shown = capsys.readouterr()
    assert json.loads(shown.out)["run"] == "night"
    assert "the result is kept on this machine only" in shown.err
    assert len(kept_results(bucket.folder / "runs/night")[0]) == 1

    bucket.answer = lambda handler: False  # it is sent along with the next one
    assert call(bc_eval, *measured) == 3
    ways = [kept.way for kept in kept_results(bucket.folder / "runs/night")[0]]
    assert ways == ["frames", "frames", "frames"]


def test_a_drive_and_its_result_are_kept_in_the_store(
    bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with StoredFolder(bucket.url("runs/night"), untrained_run(tmp_path / "here/night")) as folder:
        folder.upload()
    capsys.readouterr()
    flags = "--simulator", "lake", "--laps", 0.001, "--drives", DRIVES, "--json"
    assert call(bc_eval, "night", "--runs", RUNS, *flags) == 0
    drive = json.loads(capsys.readouterr().out)
    assert drive["log"] == f"{DRIVES}/night-lake-10mph.mcap"
    log = bucket.folder / "drives/night-lake-10mph.mcap"
    assert log.read_bytes() == Path("drives", log.name).read_bytes()
    assert [kept.way for kept in kept_results(bucket.folder / "runs/night")[0]] == ["simulator"]


def test_the_logs_of_all_simulators_are_copied(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drive_two(server: DriveServer, **_: object) -> None:
        for name in ("one", "two"):
            server.connected(name)
            server.telemetry(name, fields(0), time.perf_counter()).on_sent(1.0)

    monkeypatch.setattr(DriveServer, "run", drive_two)
    run = untrained_run(tmp_path / "here/night")
    assert call(drive_main, run, "--log", f"{DRIVES}/run.mcap", "--port", 0, "--viewer", "off") == 0
    for name in ("run.mcap", "run-2.mcap"):
        assert (bucket.folder / "drives" / name).read_bytes() == Path("drives", name).read_bytes()
