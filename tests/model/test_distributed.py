"""Several processes train one network together, and learn what one process would."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file

from bucket import serving_bucket
from common import UserError
from dataset import IndexConfig, build_index
from driving import Process
from model import train
from model.cli import train as bc_train
from model.config import TrainConfig
from model.train_flags import Train
from ports import free_ports
from repository import ROOT
from toy import toy_index

FLAGS = [
    "--network",
    "small",
    "--epochs",
    "1",
    "--batch",
    "10",
    "--dropout",
    "0",
    "--precision",
    "float32",
    "--threads",
    "1",
]


TORCHRUN = """
import os, sys
from torch.distributed.run import main
if sys.platform == "linux":
    os.environ["GLOO_SOCKET_IFNAME"] = "lo"
main()
"""


def torchrun(
    *arguments: object, processes: int = 2, begin: Sequence[str] = ("-m", "model.train"), cwd: Path = ROOT
) -> subprocess.CompletedProcess[str]:
    flags = ("--standalone", "--nproc-per-node", processes)
    line = [sys.executable, "-c", TORCHRUN, *map(str, (*flags, *begin, *arguments))]
    with Process(line, cwd, loads_pytorch=True) as run:
        code = run.join()
    return subprocess.CompletedProcess(line, code, run.stdout, "\n".join(run.stderr))


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return toy_index(tmp_path_factory.mktemp("toy"))


def epochs_of(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]


RANK = """
import os, runpy, sys
from pathlib import Path
from model import TrainConfig, train
rank, *ports, index, runs = sys.argv[1:6]
os.environ.update(RANK=rank, LOCAL_RANK=rank, MASTER_ADDR="127.0.0.1", WORLD_SIZE="2", LOCAL_WORLD_SIZE="2")
os.environ.update(GLOO_SOCKET_IFNAME="lo", MASTER_PORT=ports[0])
config = TrainConfig(network="small", epochs=1, batch=25, dropout=0.0, precision="float32", threads=1)
train(index, Path(runs, "two-25"), config)
os.environ["MASTER_PORT"] = ports[1]
sys.argv[1:] = ["--name", "two-10", *sys.argv[6:], "--index", index, "--runs", runs]
runpy.run_module("model.train", run_name="__main__", alter_sys=True)
"""


@pytest.fixture(scope="module")
def trained_by_two(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs of two processes: `two-25`, of batches of 25, by Python, and `two-10` by the command. They are told
    what torchrun tells those that it starts. Each trains both: most of its time goes into PyTorch's imports."""
    runs = tmp_path_factory.mktemp("runs")
    ports = free_ports(2)
    lines = [[sys.executable, "-c", RANK, *map(str, (rank, *ports, index, runs, *FLAGS))] for rank in (0, 1)]
    with Process(lines[0], loads_pytorch=True) as first, Process(lines[1], loads_pytorch=True) as second:
        assert (first.join(), second.join()) == (0, 0), first.stderr + second.stderr
        assert (first.stdout + second.stdout).count("epoch  1:") == 1  # one of them speaks, and writes
    return runs


@pytest.mark.skipif(sys.platform != "linux", reason="the name of the loopback interface is Linux's")
@pytest.mark.parametrize("batch", [10, 25])
def test_two_processes_learn_what_one_does(index: Path, trained_by_two: Path, tmp_path: Path, batch: int) -> None:
    """Of 26 samples, a last batch of 6 is shared as well; of a last batch of 1, one of them has nothing."""
    runs = {"one": tmp_path / "one", "two": trained_by_two / f"two-{batch}"}
    config = TrainConfig(network="small", epochs=1, batch=batch, dropout=0.0, precision="float32", threads=1)
    train(index, runs["one"], config)
    (one,), (two,) = epochs_of(runs["one"]), epochs_of(runs["two"])
    assert two["training_loss"] == pytest.approx(one["training_loss"], rel=1e-5)
    assert two["validation"]["rmse_deg"] == pytest.approx(one["validation"]["rmse_deg"], rel=1e-4)
    weights = [load_file(run / "model.safetensors") for run in runs.values()]
    moved = [np.abs(weights[0][name] - weights[1][name]) for name in weights[0]]
    # few: one step of Adam moves a weight by its rate, also where the gradient is nothing but its last bit
    assert np.mean(np.concatenate([each.ravel() for each in moved]) > 1e-6) < 0.02
    assert json.loads((runs["two"] / "config.json").read_text())["machine"]["ranks"] == 2


@pytest.fixture
def script(tmp_path: Path) -> Path:
    """`bc-train` as it is installed, and a `model.py` of somebody else in the folder where it is started."""
    script = tmp_path / "bin" / "bc-train"
    script.parent.mkdir()
    script.write_text(f"#!{sys.executable}\nfrom behavioural_cloning_toolkit import bc_train\nbc_train()\n")
    script.chmod(0o755)
    (tmp_path / "model.py").write_text("raise SystemExit('the wrong one')\n")
    return script


@pytest.mark.long  # that it starts: below; what they learn: above
def test_torchrun_starts_the_installed_command(index: Path, tmp_path: Path, script: Path) -> None:
    places = ["--index", index, "--sessions", index.parent, "--runs", tmp_path]
    done = torchrun("--name", "two", *FLAGS, *places, begin=["--no-python", str(script)], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("epoch  1:") == 1


@pytest.mark.long
def test_more_processes_than_samples_in_the_last_batch(index: Path, tmp_path: Path) -> None:
    """25 + 1: two of three processes have nothing in the second batch, and still take the step together."""
    places = ["--index", index, "--sessions", index.parent, "--runs", tmp_path]
    done = torchrun("--name", "three", *FLAGS, "--batch", 25, *places, processes=3)
    assert done.returncode == 0, done.stderr
    config = TrainConfig(network="small", epochs=1, batch=25, dropout=0.0, precision="float32", threads=1)
    train(index, tmp_path / "one", config)
    (expected,), (found,) = epochs_of(tmp_path / "one"), epochs_of(tmp_path / "three")
    assert found["training_loss"] == pytest.approx(expected["training_loss"], rel=1e-5)


@pytest.mark.long
def test_processes_that_were_stopped_go_on_together(index: Path, tmp_path: Path) -> None:
    """In two epochs, stopped between them, they learn what they do in one go; a part of a batch at a time."""
    places = ["--index", index, "--sessions", index.parent, "--runs", tmp_path]
    flags = [*FLAGS, "--micro-batch", 3, *places]
    assert torchrun("--name", "run", *flags).returncode == 0
    assert torchrun("--resume", "run", "--epochs", 2, *places).returncode == 0
    config = TrainConfig(network="small", epochs=2, batch=10, dropout=0.0, precision="float32", threads=1)
    train(index, tmp_path / "one", config)
    found, expected = ([epoch["training_loss"] for epoch in epochs_of(tmp_path / name)] for name in ("run", "one"))
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.long  # of one process: test_train_from_bucket.py
@pytest.mark.parametrize("ranks", [2, 3])
def test_weights_from_a_bucket_are_those_from_the_disk(
    tmp_path: Path, ranks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit, though each request fails the first time."""
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with serving_bucket(tmp_path / "server", monkeypatch) as bucket:
        disk = toy_index(bucket.folder)
        settings = IndexConfig(flip=False, max_uses=1, block_s=0.5, gap_s=0)
        store = build_index([bucket.url("toy.mcap")], tmp_path / "index", settings).path
        bucket.requests.clear()
        bucket.fail_each_once()
        for name, index in (("disk", disk), ("store", store)):
            places = ["--index", index, "--runs", tmp_path]
            done = torchrun("--name", name, *FLAGS, "--epochs", 2, *places, processes=ranks)
            assert done.returncode == 0, done.stderr
            assert (bucket.count() > 0) == (name == "store")
    weights = [(tmp_path / name / "model.safetensors").read_bytes() for name in ("disk", "store")]
    assert weights[0] == weights[1]


def test_a_run_that_exists_is_said_and_ends_all(index: Path, tmp_path: Path, script: Path) -> None:
    """By `--no-python bc-train`, whatever lies in the working folder."""
    (tmp_path / "run").mkdir()
    places = ["--index", index, "--sessions", index.parent, "--runs", tmp_path]
    done = torchrun("--name", "run", *FLAGS, *places, begin=["--no-python", str(script)], cwd=tmp_path)
    assert done.returncode != 0
    assert "run: exists already, and is not a run; give another --name" in done.stderr
    assert "Traceback" not in done.stderr.split("torch/distributed/elastic")[0]


@pytest.mark.parametrize("rank", [0, 1])
def test_without_an_index_nothing_is_built_by_several_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rank: int
) -> None:
    for name, value in (("WORLD_SIZE", 2), ("RANK", rank), ("LOCAL_RANK", rank)):  # as torchrun says
        monkeypatch.setenv(name, str(value))
    with pytest.raises(UserError, match="build it with `bc-index` before torchrun"):
        bc_train(Train(index=tmp_path / "index", runs=tmp_path))
    assert not (tmp_path / "index").exists()


def test_the_module_for_torchrun_does_not_hide_the_function() -> None:
    with pytest.raises(ImportError, match="gives the function"):
        importlib.import_module("model.train")
    assert importlib.import_module("model").train is train
