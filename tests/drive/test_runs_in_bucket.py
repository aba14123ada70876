"""Runs and drives in a store: what is measured of a run is kept there, and a sweep goes on on any machine."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from bucket import Bucket, serving_bucket
from common.stored_folder import StoredFolder
from drive.evaluation.eval_cli import main as bc_eval
from drive.sweep_cli import main as bc_sweep
from driving import untrained_run
from logs import write_log
from model.export_cli import main as bc_export
from model.runs.kept_results import kept_results
from toy import STEERING, road, toy_index
from udacity import call

RUNS, DRIVES = "s3://logs/runs", "s3://logs/drives"
SWEEP = """
[train]
epochs = 1
batch = 10
network = "small"
dropout = 0.0
precision = "float32"
threads = 1
[drive]
simulator = ["lake"]
laps = 0.001
"""


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
        folder.send()
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


def test_a_sweep_of_a_store_does_nothing_again_on_another_machine(
    bucket: Bucket,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    toy_index(tmp_path)
    (tmp_path / "s.toml").write_text(SWEEP)
    line = tmp_path / "s.toml", "--index", tmp_path / "index", "--runs", RUNS, "--drives", DRIVES, "--json"
    capsys.readouterr()
    assert call(bc_sweep, *line) == 0
    done = json.loads(capsys.readouterr().out)
    (drive,) = done["summary"]["results"]
    assert drive["log"] == f"{DRIVES}/s-seed0-lake-10mph.mcap"
    log = bucket.folder / "drives/s-seed0-lake-10mph.mcap"
    assert log.read_bytes() == Path("drives", log.name).read_bytes()
    assert [kept.result for kept in kept_results(bucket.folder / "runs/s-seed0")[0]] == [drive]

    on_machine("two", tmp_path, monkeypatch)
    bucket.requests.clear()
    assert call(bc_sweep, *line) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["summary"] == {**done["summary"], "folder": f"{RUNS}/s-seed0"}
    assert {method for method, _, _ in bucket.requests} == {"GET"}
    assert not any("safetensors" in path for _, path, _ in bucket.requests)
    assert not Path("runs").exists()

    # what is not all done goes on from what another machine has left: here, one that was never to be driven
    (tmp_path / "s.toml").write_text(SWEEP.partition("[drive]")[0].replace("epochs = 1", "epochs = 2"))
    assert call(bc_sweep, *line) == 0
    assert json.loads(capsys.readouterr().out)["summary"]["epochs"] == 2
    for name in ("metrics.jsonl", "model.safetensors", "results.jsonl"):
        assert (bucket.folder / "runs/s-seed0" / name).read_bytes() == Path("runs/s-seed0", name).read_bytes()
    lines = Path("runs/s-seed0/metrics.jsonl").read_text().splitlines()
    assert [json.loads(text)["epoch"] for text in lines] == [1, 2]


def test_a_run_of_a_store_is_exported_here(bucket: Bucket, tmp_path: Path) -> None:
    untrained_run(bucket.folder / "runs/night")
    before = sorted((bucket.folder / "runs/night").iterdir())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["bc-train", "export", "night", "--onnx", "--runs", RUNS])
        with pytest.raises(SystemExit) as end:
            bc_export()
    assert end.value.code == 0
    assert Path("night.onnx").is_file()
    assert sorted((bucket.folder / "runs/night").iterdir()) == before
