"""A training that is stopped, killed or out of disk goes on, and ends with the weights of one that never was."""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from common.location import local_path
from common.stored_settings import settings_from
from dataset import IndexConfig, Samples, build_index
from model import Epoch, RunError, TrainConfig, find_run, train
from model.cli import main
from model.network.choice import choose_network
from model.runs.training_progress import Step
from recorder.upkeep.edit import rewrite
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import Process, command
from tests.helpers.logs import write_log
from tests.helpers.repository import HELPERS
from tests.helpers.toy import STEERING, TINY, road
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until

# 5 batches an epoch: dropout, alterations, the mean of the weights and the scale of the answers must go on as well
NETWORK = f"{HELPERS / 'dropout_network.py'}:DropoutNetwork"
CONFIG = replace(
    TINY,
    network=NETWORK,
    epochs=2,
    batch=6,
    dropout=0.5,
    alter_each_epoch=("all",),
    average_steps=5,
    answers="natural",
)
STEP_BATCHES = "model.training.loop.STEP_BATCHES", 3  # an epoch is told of in its middle, too


@pytest.fixture(scope="module", autouse=True)
def steps_are_told_often() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(*STEP_BATCHES)
        yield


@pytest.fixture(scope="module")
def whole(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was never stopped."""
    run = tmp_path_factory.mktemp("whole") / "whole"
    train(index, run, CONFIG)
    return run


def metrics(run: Path) -> list[dict[str, Any]]:
    """What a run says of its epochs, but for the time that they took."""
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [
        {name: value for name, value in line.items() if name not in ("seconds", "samples_per_s")} for line in lines
    ]


def steps(run: Path) -> list[tuple[int, int, int, float]]:
    lines = [json.loads(line) for line in (run / "steps.jsonl").read_text().splitlines()]
    return [(line["epoch"], line["batch"], line["samples"], line["training_loss"]) for line in lines]


def assert_same(run: Path, other: Path) -> None:
    """To the last bit: the best weights, the last ones, Adam's moments, and all that was measured."""
    assert (run / "model.safetensors").read_bytes() == (other / "model.safetensors").read_bytes()
    left, right = (load_file(folder / "last" / "checkpoint.safetensors") for folder in (run, other))
    assert left.keys() == right.keys()
    assert all((left[name] == right[name]).all() for name in left)
    assert metrics(run) == metrics(other)
    assert steps(run) == steps(other)


class At:
    """Does something once training has come to a step."""

    def __init__(self, epoch: int, batch: int, action: Callable[[], object]) -> None:
        self.place = epoch, batch
        self.action = action

    def step(self, step: Step) -> None:
        if (step.epoch, step.batch) == self.place:
            self.action()

    def epoch(self, epoch: Epoch) -> None: ...
    def close(self) -> None: ...


def kill(*whatever: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def train_until_killed(
    index: str, run: str, init: str | None, at: tuple[int, int] | None, checkpoint_s: float
) -> None:
    """Without a step to be killed `at`, it is killed when the first checkpoint is about to be saved."""
    patch = pytest.MonkeyPatch()  # of this process alone
    patch.setattr(*STEP_BATCHES)
    patch.setattr("model.training.loop.CHECKPOINT_S", checkpoint_s)
    if at is None:
        patch.setattr("model.training.loop.save_checkpoint", kill)
    killed = [At(*at, kill)] if at is not None else []
    choose_network(CONFIG)  # loads its code, which a run that is gone on with does not
    train(index, run, CONFIG, killed, init=init, resume=Path(run).exists())


TRAINING = """
import json, sys
from tests.model.test_resume import train_until_killed
train_until_killed(*json.loads(sys.argv[1]))
"""


def train_killed(
    index: Path,
    run: Path,
    *,
    init: Path | None = None,
    at: tuple[int, int] | None = None,
    checkpoint_s: float = math.inf,
) -> None:
    """Train from the beginning, or go on, in a process of its own, and be killed."""
    job = (str(index), str(run), None if init is None else str(init), at, checkpoint_s)
    line = [sys.executable, "-c", TRAINING, json.dumps(job)]
    with Process(line) as training:
        assert training.join() == -signal.SIGKILL, "\n".join(training.stderr)


@pytest.mark.long  # killed once: test_a_killed_fine_tuning_resumes_...
def test_a_training_killed_again_and_again_ends_as_if_it_never_was(
    index: Path, whole: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    train_killed(index, run, at=(1, 3))  # from the beginning
    train_killed(index, run, at=(1, 5), checkpoint_s=0)  # in the middle of an epoch
    assert [step[:3] for step in steps(run)] == [(1, 3, 18), (1, 5, 26)]
    train_killed(index, run, at=(2, 3))  # what came after that is lost
    train(index, run, resume=True)
    assert_same(run, whole)


def test_ctrl_c_costs_nothing_and_reports_how_to_go_on(index: Path, whole: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        train(index, run, CONFIG, [At(1, 3, lambda: signal.raise_signal(signal.SIGINT))])
    with safe_open(run / "last" / "checkpoint.safetensors", framework="np") as file:
        position = json.loads(file.metadata()["position"])
    assert (position["epoch"], position["batch"], position["samples"]) == (1, 3, 18)
    with pytest.raises(RunError, match=rf"`bc-train resume {run}`"):
        find_run("run", tmp_path)
    stop = At(2, 3, lambda: signal.raise_signal(signal.SIGTERM))
    with pytest.raises(KeyboardInterrupt):
        train(index, run, None, [stop], resume=True)
    train(index, run, resume=True)
    assert_same(run, whole)


def test_the_command_is_stopped_by_ctrl_c_and_goes_on(index: Path, tmp_path: Path) -> None:
    """By the very command that is printed: the run knows where its index is."""
    runs = tmp_path / "all of my runs"
    places = ["--index", index, "--sessions", index.parent, "--runs", runs]
    flags = ["--network", "small", "--epochs", 2000, "--batch", 4, "--threads", 1]
    with Process(command("bc-train", "--name", "first", *flags, *places)) as training:
        wait_until(lambda: (runs / "first" / "steps.jsonl").exists() or training.popen.poll() is not None)
        assert training.end(signal.SIGINT) == 130
        go_on = training.stderr[-2].partition("continue with `bc-train ")[2].removesuffix("`")
        assert training.stderr[-1] == "bc-train: stopped"
    run = runs / "first"
    done = metrics(run) if (run / "metrics.jsonl").exists() else []
    assert call(main, *shlex.split(go_on), "--epochs", len(done) + 1) == 0
    assert [line["epoch"] for line in metrics(run)] == list(range(1, len(done) + 2))


def test_more_epochs_make_a_run_longer(index: Path, whole: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(index, run, replace(CONFIG, epochs=1))
    train(index, run, CONFIG, resume=True)
    assert_same(run, whole)
    assert json.loads((run / "config.json").read_text())["training"]["epochs"] == 2
    assert train(index, run, resume=True).epochs == []  # it has them


@pytest.fixture
def stopped(whole: Path, tmp_path: Path) -> Path:
    """A copy of the whole run, to be gone on with."""
    return Path(shutil.copytree(whole, tmp_path / "stopped"))


def test_a_killed_fine_tuning_resumes_from_its_initial_weights(index: Path, whole: Path, tmp_path: Path) -> None:
    config = replace(CONFIG, epochs=1)
    train(index, tmp_path / "straight", config, init=whole)
    train_killed(index, tmp_path / "killed", init=whole, at=(1, 3))
    train(index, tmp_path / "killed", config, resume=True)
    assert_same(tmp_path / "killed", tmp_path / "straight")


def test_a_training_killed_before_its_first_checkpoint_begins_again(
    index: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    train_killed(index, run)
    assert not list(run.rglob("*.safetensors"))
    assert call(main, "resume", "run", "--runs", tmp_path) == 0
    assert "restarted from its seed: it was stopped before anything was saved" in capsys.readouterr().out
    assert_same(run, whole)


def test_a_run_goes_on_with_its_own_settings_only(index: Path, stopped: Path) -> None:
    others: dict[str, dict[str, Any]] = {
        r"rate 0\.0002": {"rate": 0.1},
        r"network \S+:DropoutNetwork": {"network": "original"},
        "crop-rows None": {"crop_rows": (40, 20)},
    }
    for begun_with, changed in others.items():
        with pytest.raises(RunError, match=rf"began with --{begun_with} .* `bc-train continue \S*/stopped`$"):
            train(index, stopped, replace(CONFIG, epochs=9, **changed), resume=True)


def test_fewer_epochs_than_were_learnt_are_refused_and_change_nothing(index: Path, stopped: Path) -> None:
    before = (stopped / "config.json").read_bytes()
    with pytest.raises(RunError, match="has learnt from 2 epochs, not 1"):
        train(index, stopped, replace(CONFIG, epochs=1), resume=True)
    train(index, stopped, replace(CONFIG, patience=9), resume=True)  # nothing to do
    assert (stopped / "config.json").read_bytes() == before


def begun_with(run: Path, micro_batch: int) -> None:
    """As if the run had been begun where so many pictures go through at once, and nobody had said so."""
    config = json.loads((run / "config.json").read_text())
    assert config["training"]["micro_batch"] == 0
    config["machine"]["micro_batch"] = micro_batch
    (run / "config.json").write_text(json.dumps(config))


def test_a_run_goes_on_with_as_many_pictures_at_once_as_it_was_begun_with(index: Path, stopped: Path) -> None:
    begun_with(stopped, 4)
    train(index, stopped, replace(CONFIG, epochs=3), resume=True)
    config = json.loads((stopped / "config.json").read_text())
    assert config["resumed"][-1]["machine"] == config["machine"]


def test_a_run_goes_on_with_the_samples_it_was_begun_with_only(stopped: Path, tmp_path: Path) -> None:
    log = write_log(tmp_path / "toy.mcap", STEERING[:30], road, cameras=["center"])
    other = build_index([log], tmp_path / "index", IndexConfig(flip=False, max_uses=1)).path
    with pytest.raises(RunError, match=r"not the samples .*`bc-train resume .* --index .*` rebuilds its samples"):
        train(other, stopped, replace(CONFIG, epochs=9), resume=True)


def test_a_run_goes_on_when_its_log_was_rewritten(index: Path, stopped: Path, tmp_path: Path) -> None:
    with Samples(index) as samples:
        (log,) = samples.logs.values()
        settings = settings_from(IndexConfig, samples.metadata["settings"])
        fingerprint = samples.fingerprint
    rewritten = rewrite(local_path(log.path), tmp_path / log.path.name).path
    with Samples(build_index([rewritten], tmp_path / "index", settings).path) as samples:
        assert samples.fingerprint != fingerprint  # the pictures have other places
    train(tmp_path / "index", stopped, replace(CONFIG, epochs=4), resume=True)
    assert len(metrics(stopped)) == 4


def test_two_processes_do_not_train_one_run(index: Path, stopped: Path) -> None:
    before = (stopped / "metrics.jsonl").read_bytes()
    reported: list[str] = []

    def second() -> None:
        with pytest.raises(RunError) as caught:
            train(index, stopped, resume=True)
        reported.append(str(caught.value))

    train(index, stopped, replace(CONFIG, epochs=3), [At(3, 3, second)], resume=True)
    assert "is being trained by another process" in reported[0]
    assert (stopped / "metrics.jsonl").read_bytes().startswith(before)


def test_a_disk_full_while_saving_leaves_the_checkpoint_before(index: Path, whole: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(index, run, replace(CONFIG, epochs=1))
    before = (run / "last" / "checkpoint.safetensors").read_bytes()
    message = r"checkpoint\.safetensors: cannot be written \(File too large\); make room"
    with files_of_at_most(800_000), pytest.raises(RunError, match=message):  # weights fit, Adam's moments do not
        train(index, run, CONFIG, resume=True)
    assert (run / "last" / "checkpoint.safetensors").read_bytes() == before
    assert not list(run.rglob("*.part"))
    train(index, run, CONFIG, resume=True)
    assert_same(run, whole)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def edited(change: Callable[[dict[str, Any], dict[str, str]], object]) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        with safe_open(path, framework="np") as file:
            stored = dict(file.metadata())
        del stored["sha256"]  # as in earlier versions: whoever means ill can also make a checksum that holds
        tensors = load_file(path)
        change(tensors, stored)
        save_file(tensors, path, stored)

    return edit


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (cut, "cannot be read"),
        (lambda path: path.write_bytes(b"\x80\x04garbage" * 9), "cannot be read"),
        (edited(lambda tensors, stored: stored.update(format="3")), "of format 3, .* update the toolkit"),
        (edited(lambda tensors, stored: stored.pop("position")), "cannot be read"),
        (edited(lambda tensors, stored: stored.update(position='{"epoch": -1}')), "cannot be read"),
        (edited(lambda tensors, stored: stored.update(position='{"batch": 99}')), "batch 99"),
        (edited(lambda tensors, stored: tensors.popitem()), "another network"),
        (edited(lambda tensors, stored: tensors.update({"exp_avg.head.6.bias": np.zeros(2)})), "another network"),
        (
            edited(lambda tensors, stored: tensors.update({"step.head.6.bias": np.zeros(2, np.float32)})),
            "step count",
        ),
        (
            edited(lambda tensors, stored: tensors.update({"step.head.6.bias": np.array(-1, np.float32)})),
            "step count",
        ),
        (edited(lambda tensors, stored: stored.update(position=f'{{"samples": {10**400}}}')), "cannot be read"),
        (
            edited(lambda tensors, stored: tensors["network.head.6.bias"].fill(np.nan)),
            "not finite",
        ),
    ],
)
def test_a_checkpoint_that_cannot_be_used_is_named(
    index: Path, stopped: Path, damage: Callable[[Path], None], message: str
) -> None:
    damage(stopped / "last" / "checkpoint.safetensors")
    with pytest.raises(RunError, match=message) as caught:
        train(index, stopped, replace(CONFIG, epochs=9), resume=True)
    assert "checkpoint.safetensors" in str(caught.value)


def test_settings_are_those_of_the_named_run_unless_flags_say_otherwise(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = ["--index", index, "--sessions", index.parent, "--runs", tmp_path]
    flags = ["--epochs", 1, "--batch", 8, "--rate", 1e-3, "--threads", 1, "--seed", 3, "--precision", "float32"]
    assert call(main, "--name", "first", "--network", "small", *flags, *places) == 0
    assert call(main, "--name", "again", "--like", "first", *places) == 0
    first, again, other = (tmp_path / name for name in ("first", "again", "other"))
    begun_with(first, 5)
    assert call(main, "--name", "other", "--like", "first", "--seed", 0, *places) == 0
    assert json.loads((other / "config.json").read_text())["machine"]["micro_batch"] == 5
    assert (again / "model.safetensors").read_bytes() == (first / "model.safetensors").read_bytes()
    assert metrics(again) == metrics(first)
    assert settings_from(TrainConfig, json.loads((other / "config.json").read_text())["training"]) == TrainConfig(
        network="small", epochs=1, batch=8, rate=1e-3, threads=1, seed=0, precision="float32"
    )
    capsys.readouterr()
    assert call(main, "resume", "first", *places) == 0
    printed = capsys.readouterr().out
    assert "all its epochs are learnt" in printed
    assert "continued in epoch" not in printed
    assert call(main, "resume", "first", "--batch", 4, *places) == 1
    assert "began with --batch 8" in capsys.readouterr().err
    assert call(main, "resume", "nobody", *places) == 1
    assert "nobody: no run there" in capsys.readouterr().err


def test_a_run_goes_on_when_its_index_is_gone_or_elsewhere(
    index: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A project that is moved keeps together; an index that was removed is built again from the run's own logs."""
    before, after = tmp_path / "before", tmp_path / "after"
    shutil.copytree(index.parent, before / "data")
    monkeypatch.chdir(before)
    flags = ["--network", "small", "--epochs", 1, "--batch", 8, "--threads", 1, "--precision", "float32"]
    assert call(main, "--name", "first", "--index", "data/index", *flags, "--sessions", "data") == 0
    assert json.loads(Path("runs/first/config.json").read_text())["index"] == "../../data/index"
    before.rename(after)
    monkeypatch.chdir(after)
    assert call(main, "resume", "first", "--epochs", 2) == 0
    shutil.rmtree("data/index")
    assert call(main, "resume", "first", "--epochs", 3) == 0
    assert [line["epoch"] for line in metrics(Path("runs/first"))] == [1, 2, 3]
    assert json.loads(Path("runs/first/config.json").read_text())["index"] == "../../index-first"
    assert call(main, "--name", "again", "--like", "first", "--epochs", 1) == 0
    assert not Path("index").exists()
    assert all("no pictures of how it went" in line for line in capsys.readouterr().err.splitlines())


def test_like_builds_the_runs_own_index_again(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = ["--sessions", index.parent, "--runs", tmp_path / "runs"]
    flags = ["--network", "small", "--epochs", 1, "--batch", 8, "--threads", 1, "--precision", "float32"]
    assert call(main, "--name", "first", "--index", index, *flags, *places) == 0
    other = tmp_path / "index"
    build_index([index.parent / "toy.mcap"], other, IndexConfig(bins=3))
    before = (other / "samples.parquet").read_bytes()
    capsys.readouterr()
    assert call(main, "--name", "again", "--like", "first", "--index", other, *places) == 0
    assert f"{other}: not the samples of " in (printed := capsys.readouterr().err)
    assert f"{other}-first" in printed
    runs = tmp_path / "runs"
    assert (runs / "again" / "model.safetensors").read_bytes() == (
        runs / "first" / "model.safetensors"
    ).read_bytes()
    assert (tmp_path / "index-first" / "samples.parquet").exists()
    assert (other / "samples.parquet").read_bytes() == before
