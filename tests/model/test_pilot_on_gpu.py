"""A pilot on a GPU: which device is taken, and what it answers there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import model.pilot
from driving import untrained_run
from model import RunError, load_pilot
from model.device import choose_device

CPU = torch.device("cpu")
UNFIT = torch.device("meta")  # PyTorch's device without numbers: a network can be put there, and never answers


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "untrained", seed=3)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_without_a_gpu_it_is_the_processor_or_an_error(run: Path) -> None:
    assert choose_device("auto") == choose_device("cpu") == CPU
    assert load_pilot(run).device == "cpu"
    with pytest.raises(RunError, match="--device cuda: PyTorch finds no GPU here; give --device cpu"):
        load_pilot(run, device="cuda")


def test_a_network_that_does_not_work_on_the_gpu_drives_on_the_processor(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless the GPU is asked for."""
    monkeypatch.setattr(model.pilot, "choose_device", lambda device: UNFIT)
    pilot = load_pilot(run, "float32")
    assert (pilot.device, pilot.arithmetic) == ("cpu", "float32")
    monkeypatch.undo()
    crop = np.full(pilot.picture.shape, 99, np.uint8)
    assert pilot.predict(crop) == load_pilot(run, "float32", "cpu").predict(crop)
    monkeypatch.setattr(model.pilot, "choose_device", lambda device: UNFIT)
    with pytest.raises(RunError, match=r"does not work in float32 on the GPU \(.*\); give --device cpu$"):
        load_pilot(run, "float32", "cuda")
    with pytest.raises(RunError, match=r"in bfloat16 on the GPU \(.*\); give float32 or --device cpu$"):
        load_pilot(run, "bfloat16", "cuda")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU here")
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_gpu_answers_nearly_as_the_processor_does(run: Path, precision: str) -> None:
    """To half a degree, and the same number every time."""
    processor, gpu, again = (load_pilot(run, precision, device) for device in ("cpu", "cuda", "cuda"))  # type: ignore[arg-type]
    crops = np.random.default_rng(5).integers(0, 256, (20, *gpu.picture.shape), np.uint8)
    expected = pytest.approx([processor.predict(crop) for crop in crops], abs=0.02)
    assert [gpu.predict(crop) for crop in crops] == expected
    assert [gpu.predict(crop) for crop in crops] == [again.predict(crop) for crop in crops]
