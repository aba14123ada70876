"""`bc-train --runs s3://...` or `--copy-to s3://...`: a run is made here, copied there, and goes on anywhere."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from model import find_run
from model.cli import main
from model.training.trainer import train
from tests.helpers.bucket import Bucket
from tests.helpers.driving import one_line_in
from tests.helpers.toy import SMALL
from tests.helpers.udacity import call

RUNS = "s3://logs/runs"
RUN = f"{RUNS}/mine"
NETWORK = ("--recipe", "original", "--network", "small", "--dropout", "0")
FLAGS = (*NETWORK, "--batch", "4", "--rate", "2e-4", "--seed", "1")
PRECISION = ("--precision", "float32", "--threads", "1")


@pytest.fixture
def bucket(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bucket:
    """For a machine of its own."""
    (tmp_path / "one").mkdir()
    monkeypatch.chdir(tmp_path / "one")
    return bucket


def begin(index: Path, *flags: str, name: str = "mine", to: str = "--copy-to") -> int:
    return call(main, "--index", index, "--name", name, *FLAGS, *PRECISION, *flags, to, RUNS)


def files(folder: Path) -> dict[str, bytes]:
    paths = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def test_a_run_is_copied_and_goes_on_on_another_machine(
    bucket: Bucket,
    index: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert begin(index, "--epochs", "1", to="--runs") == 0
    assert files(bucket.folder / "runs/mine") == files(Path("runs/mine"))
    (tmp_path / "two").mkdir()
    monkeypatch.chdir(tmp_path / "two")
    capsys.readouterr()
    assert call(main, "--resume", "mine", "--runs", RUNS, "--index", index, "--epochs", "2") == 0
    assert "continued in epoch 2" in capsys.readouterr().out
    assert files(bucket.folder / "runs/mine") == files(Path("runs/mine"))
    alone = train(index, tmp_path / "alone", replace(SMALL, epochs=2)).run
    assert (find_run(RUN, "runs") / "model.safetensors").read_bytes() == (alone / "model.safetensors").read_bytes()
    # the first machine has not learnt that, and replaces nothing by what it has
    monkeypatch.chdir(tmp_path / "one")
    before = files(bucket.folder / "runs/mine")
    assert call(main, "--resume", "mine", "--index", index, "--epochs", "3", "--copy-to", RUNS) == 3
    assert "another machine has changed it at the same time" in " ".join(capsys.readouterr().err.split())
    assert files(bucket.folder / "runs/mine") == before


def test_a_name_that_is_taken_there_is_refused_before_anything_is_learnt(
    bucket: Bucket, index: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bucket.folder / "runs/mine").mkdir(parents=True)
    (bucket.folder / "runs/mine/config.json").write_text("{}")
    assert begin(index) == 1
    assert f"{RUN}: exists already" in capsys.readouterr().err
    assert not Path("runs").exists()
    assert call(main, "--resume", "s3://logs/runs/none") == 1
    assert "no run there" in capsys.readouterr().err


def test_a_run_that_cannot_be_copied_is_kept_and_the_command_is_named(
    bucket: Bucket, index: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bucket.answer = lambda handler: handler.command == "PUT" and bool(handler.fail(403, "AccessDenied"))
    assert begin(index, "--epochs", "1") == 3
    told = " ".join(capsys.readouterr().err.split())
    assert "runs/mine: not all of it is in s3://logs/runs/mine" in told
    assert "bc-train --resume mine" in told
    bucket.answer = lambda handler: False
    assert call(main, "--resume", "mine", "--index", index, "--copy-to", RUNS) == 0
    assert files(bucket.folder / "runs/mine") == files(Path("runs/mine"))


def test_another_run_of_that_name_here_is_not_replaced(
    bucket: Bucket, index: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bucket.folder / "runs/mine").mkdir(parents=True)
    (bucket.folder / "runs/mine/config.json").write_text("{}")
    Path("runs/mine").mkdir(parents=True)
    Path("runs/mine/config.json").write_text("ours")
    assert call(main, "--resume", RUN, "--index", index) == 1
    assert f"runs/mine: exists, but is not a copy of {RUN}" in capsys.readouterr().err
    assert files(Path("runs/mine")) == {"config.json": b"ours"}


def test_a_run_is_begun_like_another_there_and_from_its_weights(
    bucket: Bucket, index: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert begin(index, "--epochs", "1", to="--runs") == 0
    shutil.rmtree("runs")
    assert begin(index, "--epochs", "1", "--init", "mine", name="more", to="--runs") == 0
    init = json.loads((bucket.folder / "runs/more/config.json").read_text())["init"]
    assert (init["run"], init["place"]) == ("mine", RUN)
    shutil.rmtree("runs")
    # its index is found where it would be of a run in runs/
    assert call(main, "--like", "more", "--runs", RUNS, *PRECISION, "--name", "again") == 0
    weights = [(bucket.folder / "runs" / name / "model.safetensors").read_bytes() for name in ("more", "again")]
    assert weights[0] == weights[1]
    assert sorted(path.name for path in Path("runs").iterdir()) == ["again"]
    capsys.readouterr()
    assert call(main, "--like", "mroe", "--runs", RUNS) == 1
    assert "did you mean more?" in one_line_in(capsys)
    assert call(main, "--name", "x", "--runs", RUNS, "--copy-to", RUNS) == 2
    assert "leave out --copy-to" in one_line_in(capsys)
