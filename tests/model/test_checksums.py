"""Weights and checkpoints carry their own checksum: one flipped bit is found wherever they are loaded, and a kill
never leaves weights with the checksum of others."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from model import RunError, load_pilot, predict_log, train
from model.evaluation.evaluate import evaluate, evaluate_sessions
from model.onnx_export import export_onnx
from tests.helpers.toy import ONE


@pytest.fixture
def run(trained: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(trained, tmp_path / "first"))


def weights(run: Path) -> Path:
    return run / "model.safetensors"


def checkpoint(run: Path) -> Path:
    return run / "last" / "checkpoint.safetensors"


def flip(path: Path, byte: int, bit: int = 0) -> None:
    data = bytearray(path.read_bytes())
    data[byte] ^= 1 << bit
    path.write_bytes(data)


def header_of(path: Path) -> bytes:
    data = path.read_bytes()
    return data[8 : 8 + int.from_bytes(data[:8], "little")]


def of_an_earlier_version(path: Path) -> None:
    """As they were written before there were checksums."""
    with safe_open(path, framework="np") as file:
        stored = {name: value for name, value in file.metadata().items() if name != "sha256"}
    save_file(load_file(path), path, stored)


def test_the_checksum_is_that_of_the_file_with_zeros_in_its_place(trained: Path) -> None:
    for path in (weights(trained), checkpoint(trained)):
        stored = json.loads(header_of(path))["__metadata__"]["sha256"]
        data = path.read_bytes()
        assert data.count(stored.encode()) == 1
        assert hashlib.sha256(data.replace(stored.encode(), b"0" * 64)).hexdigest() == stored


@pytest.mark.parametrize(("name", "hole_bytes"), [("model.safetensors", 1 << 29), ("last", 1 << 42)])
def test_a_file_too_large_for_its_network_is_not_read(run: Path, name: str, hole_bytes: int) -> None:
    path = checkpoint(run) if name == "last" else weights(run)
    os.truncate(path, hole_bytes)
    with pytest.raises(RunError, match=rf"{path.name}: cannot be read \(.*larger than 2\d\d MB"):
        load_pilot(run / "last" if name == "last" else run)


def test_others_read_the_weights_as_they_are(trained: Path) -> None:
    with safe_open(weights(trained), framework="np") as file:
        assert file.metadata()["epoch"] == "1"
        tensors = [file.get_tensor(name) for name in file.keys()]  # noqa: SIM118
    assert sum(tensor.size for tensor in tensors) == 81_929
    assert {tensor.dtype for tensor in tensors} == {np.dtype(np.float32)}
    assert all(np.isfinite(tensor).all() for tensor in tensors)
    assert len(header_of(weights(trained))) % 8 == 0  # the tensors can be mapped into memory


def refused(action: Callable[[], object], path: Path) -> None:
    with pytest.raises(RunError, match=rf"{re.escape(str(path))}: damaged.*copy it again"):
        action()


def test_one_flipped_bit_is_found_wherever_weights_are_loaded(index: Path, run: Path, tmp_path: Path) -> None:
    flip(weights(run), weights(run).stat().st_size - 80_000, 6)
    log = index.parent / "toy.mcap"
    for action in (
        lambda: load_pilot(run),
        lambda: evaluate(run, index),
        lambda: evaluate_sessions(run, [log]),
        lambda: export_onnx(run, tmp_path / "first.onnx"),
        lambda: predict_log(log, [run]),
        lambda: predict_log(log, [run], on_attention=lambda *reported: None),
        lambda: train(index, tmp_path / "second", ONE, init=run),
    ):
        refused(action, weights(run))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first"]
    load_pilot(run / "last")  # that is another file


def test_one_flipped_bit_in_a_checkpoint_is_not_trained_on(index: Path, run: Path) -> None:
    flip(checkpoint(run), checkpoint(run).stat().st_size - 500_000, 6)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    refused(lambda: train(index, run, replace(ONE, epochs=2), resume=True), checkpoint(run))
    refused(lambda: load_pilot(run / "last"), checkpoint(run))
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_any_flipped_bit_is_found(run: Path, caplog: pytest.LogCaptureFixture) -> None:
    """All through the header, and here and there in the weights; only in the checksum's own name does a flip make
    the file one of an earlier version, and that is said."""
    whole = weights(run).read_bytes()
    header = header_of(weights(run))
    end = 8 + len(header)
    name = 8 + header.index(b'"sha256"')
    named = range(name + 1, name + 7)
    places = [*range(0, end, 97), *range(name, name + 76, 5), *range(end, len(whole), 25_007), len(whole) - 1]
    for place in sorted(set(places)):
        data = bytearray(whole)
        data[place] ^= 2
        weights(run).write_bytes(data)
        caplog.clear()
        if place in named:
            load_pilot(run, "float32")
            assert "without checksums" in caplog.text
        else:
            with pytest.raises(RunError, match=r"model\.safetensors: "):
                load_pilot(run, "float32")


def test_runs_of_earlier_versions_are_read_and_that_is_said_once(
    index: Path, run: Path, caplog: pytest.LogCaptureFixture
) -> None:
    expected = load_pilot(run).predict(np.full((48, 96, 3), 99, np.uint8))
    for path in (weights(run), checkpoint(run)):
        of_an_earlier_version(path)
    assert load_pilot(run).predict(np.full((48, 96, 3), 99, np.uint8)) == expected
    load_pilot(run / "last")
    train(index, run, replace(ONE, epochs=2), resume=True)
    [record] = caplog.records
    assert record.levelno == logging.WARNING
    assert record.getMessage().startswith(f"{run}: of an earlier version, without checksums")
    assert b"sha256" in header_of(checkpoint(run))  # what is written from now on has one
