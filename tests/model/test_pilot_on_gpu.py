"""A pilot on a GPU: which device is taken, and the recorded network. Only the recording itself needs a GPU."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import model.pilot
from dataset.preprocessing import Image
from model import RunError, load_pilot
from model.device import choose_device
from model.network import replayed
from model.network.replayed import replayed_if_equal
from tests.helpers.driving import untrained_run

CPU = torch.device("cpu")
UNFIT = torch.device("meta")  # PyTorch's device without numbers: a network can be put there, and never answers
SHAPE = (4, 6, 3)
WEIGHTS = torch.linspace(-1, 1, 4 * 6 * 3).reshape(1, 3, 4, 6)

Recorded = tuple[Callable[[], None], Tensor]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "untrained", seed=3)


def calculate(inputs: Tensor) -> Tensor:
    """Two answers to a picture (1, 3, 4, 6)."""
    mean = (inputs.float() * WEIGHTS).mean()
    return torch.stack([mean, -mean])


def pictures(count: int) -> Image:
    return np.random.default_rng(5).integers(0, 256, (count, 1, *SHAPE), np.uint8)


def in_place_of_graph(monkeypatch: pytest.MonkeyPatch, wrong: float = 0.0) -> None:
    """A processor's recording: the calculation is made again, and its answers are put where the first ones are."""

    def record(calculate: Callable[[], Tensor], device: torch.device, calls_before: int) -> Recorded:
        answers = calculate().clone()

        def replay() -> None:
            answers.copy_(calculate() + wrong)

        return replay, answers

    monkeypatch.setattr(replayed, "record", record)


def test_a_recorded_calculation_answers_to_each_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    in_place_of_graph(monkeypatch)
    recorded = replayed_if_equal(calculate, SHAPE, CPU)
    assert recorded is not None
    with torch.inference_mode():
        answers = [recorded(picture) for picture in pictures(5)]
        expected = [calculate(torch.from_numpy(picture).permute(0, 3, 1, 2)).numpy() for picture in pictures(5)]
    np.testing.assert_array_equal(answers, expected)  # none is overwritten by the next one
    assert len({answer[0] for answer in answers}) == 5


def test_a_recording_that_answers_otherwise_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    in_place_of_graph(monkeypatch, wrong=0.5)
    assert replayed_if_equal(calculate, SHAPE, CPU) is None


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_pilot_answers_alike_if_recorded(run: Path, monkeypatch: pytest.MonkeyPatch, precision: str) -> None:
    plain, pilot = (load_pilot(run, precision, "cpu") for _ in range(2))  # type: ignore[arg-type]
    crops = np.random.default_rng(5).integers(0, 256, (5, *pilot.picture.shape), np.uint8)
    in_place_of_graph(monkeypatch)
    pilot.device = "cuda"
    threads = torch.get_num_threads()
    try:
        pilot.warm_up()
    finally:
        torch.set_num_threads(threads)
    assert pilot._replayed is not None
    assert [pilot.answer(crop) for crop in crops] == [plain.answer(crop) for crop in crops]
    assert pilot.predict(crops[0][:, ::-1]) == plain.predict(crops[0][:, ::-1])


@pytest.mark.needs("no_gpu")
def test_without_a_gpu_it_is_the_processor_or_an_error(run: Path) -> None:
    assert choose_device("auto") == choose_device("cpu") == CPU
    assert load_pilot(run).device == "cpu"
    with pytest.raises(RunError, match="--device cuda: PyTorch finds no GPU; give --device cpu"):
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


@pytest.mark.needs("gpu")
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_gpu_answers_nearly_as_the_processor_does(run: Path, precision: str) -> None:
    """To half a degree, and the same number every time."""
    processor, gpu, again = (load_pilot(run, precision, device) for device in ("cpu", "cuda", "cuda"))  # type: ignore[arg-type]
    crops = np.random.default_rng(5).integers(0, 256, (20, *gpu.picture.shape), np.uint8)
    expected = pytest.approx([processor.predict(crop) for crop in crops], abs=0.02)
    assert [gpu.predict(crop) for crop in crops] == expected
    threads = torch.get_num_threads()
    try:
        for pilot in (gpu, again):
            pilot.warm_up()
            assert pilot._replayed is not None
    finally:
        torch.set_num_threads(threads)
    assert [gpu.predict(crop) for crop in crops] == expected
    assert [gpu.predict(crop) for crop in crops] == [again.predict(crop) for crop in crops]
