"""A trained network that steers, one picture at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.named_function import in_one_line
from common.process_settings import keep_freed_memory
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import STEERING_ONLY, TARGETS, TargetName
from dataset.preprocessing import Image, crop_of, in_channels
from model.config import Device, Precision
from model.device import choose_device, training_dtype
from model.errors import RunError
from model.evaluation.predict import as_input
from model.network.faster_layers import pack_weights, sliced_max_pool, swap_layers
from model.network.picture_network import PictureNetwork
from model.network.replayed import ROUNDING, Replayed, exactly, replayed_if_equal
from model.runs.run_folder import (
    load_network,
    picture_of_run,
    run_name,
    speed_ahead_s_of_run,
    targets_of_run,
    weights_checksum,
)

WARM_UP_PREDICTIONS = 20

_PROCESSOR = torch.device("cpu")


class NetworkAnswer(NamedTuple):
    """A network's answer to a picture; NaN or infinite if the weights are."""

    steering: float  # -1 (left) .. 1 (right), not clamped
    speed_mph: float | None = None  # target speed; None: the network does not answer it
    throttle: float | None = None  # -1 .. 1, not clamped; None: the network does not answer it

    @property
    def is_finite(self) -> bool:
        """True if the car can drive with this answer."""
        return all(value is None or math.isfinite(value) for value in self)


class Pilot:
    """Predicts steering from the car's pictures. On one device, the same picture gives the same number."""

    def __init__(
        self,
        network: PictureNetwork,
        run: str = "",
        weights_sha256: str = "",
        dtype: torch.dtype = torch.float32,
        picture: PictureSpec | None = None,
        targets: Sequence[TargetName] = STEERING_ONLY,
        speed_ahead_s: float = 0.0,
        device: torch.device = _PROCESSOR,
    ) -> None:
        """Moves the network itself to `device`, and rounds its weights to `dtype`, float32 or bfloat16.

        `picture` is the picture that the network sees, by default its own; `targets` are its answers. The car
        should have an answered speed `speed_ahead_s` later. Raises ValueError if the number of the network's
        answers is not that of `targets`, RuntimeError if the network does not work on the device or in `dtype`.
        """
        if len(targets) != network.outputs:
            raise ValueError(f"{len(targets)} targets for a network with {network.outputs} answers")
        self.run = run
        self.weights_sha256 = weights_sha256
        self.arithmetic = str(dtype).removeprefix("torch.")
        """The arithmetic of the network: "float32" or "bfloat16"."""
        self.device = device.type
        """The device of the network: "cpu" or "cuda"."""
        self.picture = picture or network.PICTURE
        self.targets = tuple(targets)
        self.speed_ahead_s = speed_ahead_s
        network.input_dtype = dtype
        self._network = network.eval().to(device, dtype, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._device = device
        self._replayed: Replayed | None = None
        if device != _PROCESSOR:
            self._answers(np.zeros(self.picture.shape, np.uint8))  # an error comes now, not in a drive
            return
        self._swap_if_equal(lambda: swap_layers(network, sliced_max_pool))
        if dtype == torch.bfloat16:
            self._swap_if_equal(lambda: pack_weights(network))

    def crop(self, picture: Image) -> Image:
        """The crop (`picture.shape`) BGR that the network sees of a camera picture (height, width, 3) BGR."""
        return crop_of(picture, self.picture)

    def answer(self, crop: Image) -> NetworkAnswer:
        """The network's answers to a crop (`picture.shape`) BGR uint8."""
        values = self._answers(crop).tolist()
        answers = {TARGETS[name].answer_name: value for name, value in zip(self.targets, values, strict=True)}
        if "speed_mph" in answers:
            answers["speed_mph"] *= TARGETS["speed"].per_unit
        return NetworkAnswer(**answers)

    @torch.inference_mode()
    def _answers(self, crop: Image) -> NDArray[np.float32]:
        """The answers (K,) in the units of the labels."""
        pixels = np.ascontiguousarray(in_channels(crop, self.picture))[None]
        if self._replayed is not None:
            return self._replayed(pixels)
        answers: NDArray[np.float32] = self._calculate(as_input(pixels).to(self._device)).cpu().numpy()
        return answers

    def _calculate(self, inputs: Tensor) -> Tensor:
        """The answers (K,) to a picture (1, 3, height, width) uint8, both on the device."""
        with exactly(self._device):
            answers: Tensor = self._network(inputs).flatten().float()
        return answers

    def predict(self, crop: Image) -> float:
        """The steering of `answer`."""
        return self.answer(crop).steering

    def warm_up(self) -> None:
        """Prepare this process for driving: make the first predictions, which are slow.

        From now on, the process computes on one thread. Two threads take a fifth less time for a picture. But on a
        busy machine, every layer waits for the slower one (one answer in a hundred takes 20 ms), and the last bits
        of the steering depend on the number of threads. A GPU replays its recorded work on a picture if it can.
        """
        keep_freed_memory()
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
        if self.device == "cuda" and self._replayed is None:
            self._replayed = replayed_if_equal(self._calculate, self.picture.shape, self._device)
        for _ in range(WARM_UP_PREDICTIONS):
            self.predict(np.zeros(self.picture.shape, np.uint8))

    def _swap_if_equal(self, swap: Callable[[], Callable[[], None] | None]) -> None:
        """Replace layers of the network by faster ones if its answer stays equal: a user's own network may use its
        layers in other ways."""
        noise = np.random.default_rng(0).integers(0, 256, self.picture.shape, np.uint8)
        before = self._answers(noise)
        if (undo := swap()) is None:
            return
        try:
            after = self._answers(noise)
        except Exception:
            undo()
            return
        if not np.allclose(after, before, rtol=ROUNDING, atol=ROUNDING, equal_nan=True):
            undo()


def load_pilot(run: Path | str, precision: Precision = "auto", device: Device = "auto") -> Pilot:
    """The pilot of a run folder.

    `device` "auto" takes a GPU if there is one. `precision` "auto" takes bfloat16 if the device supports it, as
    training does. On a processor, bfloat16 takes five eighths of the time of float32, in which evaluations
    measure. On 5,000 pictures, a trained network's steering differed by 0.02 degrees on average, 0.2 at most.

    With "auto", a network that does not work in bfloat16 drives in float32, and one that does not work on the GPU
    drives on the processor.

    Raises RunError if the run is incomplete, damaged or of another version, if its network does not work on this
    machine, if it is a user's own and was not named (`load_code`), or if the device does not exist.
    """
    run = Path(run)
    picture = picture_of_run(run)
    answers = targets_of_run(run), speed_ahead_s_of_run(run)
    problem = ""
    for chosen, dtype in _ways(precision, device):
        network = load_network(run)  # first: its errors name what is wrong with the file of the weights
        about = run_name(run), weights_checksum(run)
        try:
            return Pilot(network, *about, dtype, picture, *answers, chosen)
        except (RuntimeError, TypeError) as error:  # for example, an operation without a bfloat16 or GPU version
            place = "" if chosen == _PROCESSOR else " on the GPU"
            problem = f"in {str(dtype).removeprefix('torch.')}{place} ({in_one_line(error)})"
    other = " or ".join(
        [*(["float32"] if precision == "bfloat16" else []), *(["--device cpu"] if device == "cuda" else [])]
    )
    raise RunError(f"{run}: its network does not work {problem}{f'; give {other}' if other else ''}")


def _ways(precision: Precision, device: Device) -> Iterator[tuple[torch.device, torch.dtype]]:
    """The devices and arithmetics to try, the best first."""
    chosen = choose_device(device)
    for place in dict.fromkeys([chosen, _PROCESSOR] if device == "auto" else [chosen]):
        dtype = training_dtype(precision, place)
        yield place, dtype
        if precision == "auto" and dtype != torch.float32:
            yield place, torch.float32
