"""Training leaves a run that says where it comes from, and whose numbers can be checked against its files."""

from __future__ import annotations

import json
import math
import shutil
import statistics
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import torch

from common.stored_settings import settings_from
from dataset import IndexConfig, Loader, Samples, build_index, decode
from dataset.cli import main as bc_index
from dataset.preprocessing import Image
from model import Epoch, RunError, TrainConfig, find_run, load_pilot, train
from model.cli import main
from model.network.choice import built_in
from recorder import Log
from tests.helpers.logs import plain_read, write_log
from tests.helpers.repository import HELPERS
from tests.helpers.toy import SMALL, STEERING, road
from tests.helpers.udacity import call

SETTINGS = replace(SMALL, rate=1e-3)  # the original's millions of weights: test_bc_train_builds_the_index_...


@pytest.fixture(scope="module")
def trained(index: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Epoch]]:
    run = tmp_path_factory.mktemp("runs") / "toy"
    return run, train(index, run, SETTINGS).epochs


def contents(run: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}


def test_the_loss_falls_and_beats_knowing_nothing(trained: tuple[Path, list[Epoch]]) -> None:
    _, history = trained
    assert [epoch.epoch for epoch in history] == [1, 2, 3, 4]
    assert history[-1].training_loss < 0.8 * history[0].training_loss
    assert history[-1].training_loss < statistics.pvariance(STEERING)


def test_the_run_reports_where_it_comes_from(trained: tuple[Path, list[Epoch]], index: Path) -> None:
    run, _ = trained
    config = json.loads((run / "config.json").read_text())
    assert config["format"] == 4
    assert config["parameters"] == 81_929
    assert config["preprocessing"]["channels"] == "BGR"
    assert (config["preprocessing"]["crop_top"], config["preprocessing"]["crop_bottom"]) == ("50/160", "20/160")
    assert settings_from(TrainConfig, config["training"]) == SETTINGS
    machine = {"device": "cpu", "arithmetic": "float32", "micro_batch": 64, "threads": 1}
    assert config["machine"] == {**machine, "torch": torch.__version__}
    assert config["versions"].keys() >= {"python", "torch", "numpy", "opencv"}
    assert config["versions"]["torch"] == torch.__version__
    assert config["versions"]["opencv"].startswith(cv2.__version__)
    with Log(index.parent / "toy.mcap") as log:
        assert config["data"]["logs"]["toy"]["fingerprint"] == log.fingerprint
    assert len(bytes.fromhex(config["data"]["fingerprint"])) == 32
    assert config["data"]["settings"]["seed"] == 0
    assert {path.name for path in run.iterdir()} >= {"config.json", "metrics.jsonl", "model.safetensors"}
    assert not list(run.glob("*.part"))


@pytest.mark.parametrize(
    ("samples", "batch", "passes"),
    [(64 * 150, 64, 1), (64 * 149, 64, 2), (64 * 30, 64, 5), (1, 64, 10), (10**6, 64, 1), (10_470, 256, 4)],
)
def test_a_short_recording_is_passed_more_often(samples: int, batch: int, passes: int) -> None:
    assert TrainConfig(batch=batch).with_passes(samples).epochs == passes
    assert TrainConfig(batch=batch, epochs=3).with_passes(samples).epochs == 3


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(
    trained: tuple[Path, list[Epoch]], index: Path, tmp_path: Path
) -> None:
    network = f"{HELPERS / 'dropout_network.py'}:DropoutNetwork"

    def weights(name: str, seed: int) -> bytes:
        config = replace(SETTINGS, network=network, dropout=0.5, epochs=1, batch=8, seed=seed)
        train(index, tmp_path / name, config)
        return (tmp_path / name / "model.safetensors").read_bytes()

    first = weights("a", 1)
    assert weights("b", 1) == first
    assert weights("c", 2) != first


def test_other_data_has_another_fingerprint(
    trained: tuple[Path, list[Epoch]], index: Path, tmp_path: Path
) -> None:
    def fingerprint(run: Path) -> str:
        data: dict[str, str] = json.loads((run / "config.json").read_text())["data"]
        return data["fingerprint"]

    log = write_log(tmp_path / "toy.mcap", STEERING[:4], road, cameras=["center"])
    other = build_index([log], tmp_path / "index", IndexConfig(flip=False, max_uses=1, validation_share=0.0)).path
    config = TrainConfig(network="small", epochs=1, batch=4, precision="float32", threads=1)
    [epoch] = train(other, tmp_path / "run", config).epochs
    assert math.isnan(epoch.measures.network.mae_deg)  # nothing was held out
    assert fingerprint(tmp_path / "run") != fingerprint(trained[0])


def test_a_run_that_exists_is_refused_and_stays(trained: tuple[Path, list[Epoch]], index: Path) -> None:
    run, _ = trained
    before = contents(run)
    with pytest.raises(RunError, match="exists already"):
        train(index, run, SETTINGS)
    assert contents(run) == before


def test_bc_train_builds_the_index_and_prints_each_epoch(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["--index", tmp_path / "index", "--sessions", index.parent, "--runs", tmp_path / "runs"]
    flags = ["--name", "first", "--epochs", 1, "--batch", 64, "--threads", 1]
    assert call(main, *line, *flags) == 3
    reported = capsys.readouterr()
    assert "5,022,327 parameters" in reported.out
    assert "epoch  1: loss 0." in reported.out
    assert "nothing held out" in reported.out  # four seconds are one block
    assert "no index yet" in reported.err
    assert "no frame is held out, so the network's error is unknown" in reported.err
    assert find_run(None, tmp_path / "runs") == tmp_path / "runs" / "first"
    assert call(main, *line, *flags) == 1
    assert "first: exists already" in capsys.readouterr().err


def test_driving_sees_the_same_pixels_as_training(trained: tuple[Path, list[Epoch]], index: Path) -> None:
    pilot = load_pilot(trained[0], "float32")
    samples = Samples(index)
    try:
        loader = Loader(samples, samples.table, batch=16, seen=built_in("small", {}).picture)
        learnt: list[Image] = [picture for batch in loader.in_order() for picture in batch.pictures]
    finally:
        samples.close()
    for row, picture in zip(samples.table.to_pylist(), learnt, strict=True):
        jpeg = plain_read(index.parent / "toy.mcap", row["offset"], row["length"])
        assert jpeg == road("center", row["row"])
        assert (pilot.crop(decode(jpeg)) == picture).all()


def test_an_index_of_bc_train_leaves_out_unreadable_logs_and_names_them(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exactly as `bc-index` does."""
    Path("sessions").mkdir()
    write_log(Path("sessions") / "good.mcap", STEERING, road, cameras=["center"])
    Path("sessions/bad.mcap").write_bytes(b"no log")
    Path("sessions/killed.mcap.0a1b2c.part").write_bytes(b"\x89MCAP0\r\n")
    assert call(bc_index) == 3
    expected = capsys.readouterr().err.splitlines()
    shutil.rmtree("index")
    flags = ["--name", "first", "--network", "small", "--epochs", 1, "--batch", 64, "--threads", 1]
    assert call(main, *flags) == 3
    reported = capsys.readouterr().err.splitlines()
    assert any("bad.mcap: not an MCAP log" in line for line in expected)
    assert any("killed.mcap.0a1b2c.part: not indexed" in line for line in expected)
    assert set(reported) >= {line for line in expected if "sessions/" in line}
    assert json.loads(Path("runs/first/config.json").read_text())["data"]["logs"].keys() == {"good"}


def test_an_index_that_is_built_again_for_like_shows_of_unfinished_logs(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("sessions").mkdir()
    whole = write_log(cwd / "whole.mcap", STEERING, road, cameras=["center"])
    log = Path("sessions/cut.mcap")
    log.write_bytes(whole.read_bytes()[:-40])  # its end
    assert call(bc_index, "--block-s", 0.5, "--gap-s", 0) == 3
    notice = next(line for line in capsys.readouterr().err.splitlines() if "cut.mcap" in line)
    flags = ["--network", "small", "--epochs", 1, "--batch", 64, "--threads", 1]
    assert call(main, "--name", "first", *flags) == 0  # it was said when the index was built
    shutil.rmtree("index")
    capsys.readouterr()
    assert call(main, "--name", "again", "--like", "first") == 3
    assert notice in capsys.readouterr().err.splitlines()


def test_a_run_whose_frames_were_chosen_in_sql_is_not_repeated(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("sessions").mkdir()
    write_log(Path("sessions/lake.mcap"), STEERING, road, cameras=["center"])
    assert call(bc_index, "--block-s", 0.5, "--gap-s", 0, "--where", "row != 7") == 0
    flags = ["--network", "small", "--epochs", 1, "--batch", 64, "--threads", 1]
    assert call(main, "--name", "first", *flags) == 0
    shutil.rmtree("index")
    config = Path("runs/first/config.json")
    config.write_text(config.read_text().replace("row != 7", "row between 8 and 99"))
    capsys.readouterr()
    assert call(main, "--name", "again", "--like", "first") == 1
    printed = capsys.readouterr().err
    assert "first/config.json: its index settings cannot be used (--where 'row between" in printed
    assert "write 5 <= row <= 9" in printed


def test_no_index_is_built_of_logs_that_have_changed(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("sessions").mkdir()
    write_log(Path("sessions/lake.mcap"), STEERING, road, cameras=["center"])
    flags = ["--network", "small", "--epochs", 1, "--batch", 64, "--threads", 1]
    assert call(main, "--name", "first", *flags) in (0, 3)  # nothing may be held out
    write_log(Path("sessions/lake.mcap"), STEERING[:-9], road, cameras=["center"], overwrite=True)
    before = sorted(cwd.rglob("*"))
    capsys.readouterr()
    assert call(main, "--name", "again", "--like", "first") == 1
    assert "sessions: lake changed since runs/first was trained on them" in capsys.readouterr().err
    assert sorted(cwd.rglob("*")) == before
