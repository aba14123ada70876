"""Work on a GPU, recorded once as a CUDA graph and then replayed: training steps, and a network that answers one
picture at a time.

Called layer by layer, the GPU waits for Python: with PyTorch 2.11 on an H200, a picture takes 0.57 ms. The graph
starts all layers at once: 0.19 ms.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

ROUNDING: Final = 0.02  # of bfloat16 sums in another order

_CALLS_BEFORE: Final = 3  # libraries initialise themselves in the first calls
_CHECKED_PICTURES: Final = 3

_failed: Final[list[torch.cuda.CUDAGraph]] = []
"""Graphs whose recording failed. They are kept alive because PyTorch may still ask them for their memory."""


class Replayed:
    """A recorded calculation. Pictures and answers go through buffers at fixed addresses."""

    def __init__(
        self, calculate: Callable[[Tensor], Tensor], shape: tuple[int, int, int], device: torch.device
    ) -> None:
        """`calculate` computes answers (K,) float32 for one picture (1, 3, height, width) uint8 in channels_last;
        `shape` is (height, width, 3). Raises what `calculate` raises, and RuntimeError if it cannot be
        recorded."""
        is_pinned = device.type == "cuda"
        self._device = device
        self._host_pixels = torch.zeros((1, *shape), dtype=torch.uint8, pin_memory=is_pinned)
        self._pixels = self._host_pixels.to(device, copy=True)
        inputs = self._pixels.permute(0, 3, 1, 2)
        self._replay, self._answers = record(lambda: calculate(inputs), device, _CALLS_BEFORE)
        self._host_answers = torch.zeros(self._answers.shape, pin_memory=is_pinned)

    def __call__(self, pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The answers (K,) to one picture (1, height, width, 3)."""
        np.copyto(self._host_pixels.numpy(), pixels)
        self._pixels.copy_(self._host_pixels, non_blocking=True)
        self._replay()
        self._host_answers.copy_(self._answers, non_blocking=True)
        if self._device.type == "cuda":
            torch.cuda.current_stream(self._device).synchronize()
        answers: NDArray[np.float32] = self._host_answers.numpy().copy()
        return answers


@torch.inference_mode()
def replayed_if_equal(
    calculate: Callable[[Tensor], Tensor], shape: tuple[int, int, int], device: torch.device
) -> Replayed | None:
    """A `Replayed` of a calculation; None if it cannot be recorded, or if its replayed answers differ.

    For example, a user's own network cannot be recorded if it reads numbers from the GPU during the calculation.
    """
    draw = np.random.default_rng(0)
    pictures = draw.integers(0, 256, (_CHECKED_PICTURES, 1, *shape), np.uint8)
    try:
        expected = [
            calculate(torch.from_numpy(batch).permute(0, 3, 1, 2).to(device)).cpu().numpy() for batch in pictures
        ]
        replayed = Replayed(calculate, shape, device)
        answers = [replayed(batch) for batch in pictures[::-1]][::-1]
    except Exception:
        return None
    is_equal = np.allclose(answers, expected, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)
    return replayed if is_equal else None


def record(
    calculate: Callable[[], Tensor], device: torch.device, calls_before: int = 0
) -> tuple[Callable[[], None], Tensor]:
    """Record a calculation on the GPU `device`, after `calls_before` calls of it. Returns a function that runs it,
    and the tensor that then holds its result.

    Raises RuntimeError, or what `calculate` raises, if it cannot be recorded. The GPU stays usable.
    """
    graph, pool = torch.cuda.CUDAGraph(), torch.cuda.graph_pool_handle()
    # on another GPU than the current one, nothing would be recorded, and no error raised
    with torch.cuda.device(device), _usable_if_failed(graph, pool, device):
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            with _waiting_raises():
                for _ in range(calls_before):
                    calculate()
            # other threads may use the GPU meanwhile
            with torch.cuda.graph(graph, pool=pool, stream=stream, capture_error_mode="thread_local"):
                result = calculate()
    return graph.replay, result


@contextlib.contextmanager
def _usable_if_failed(graph: torch.cuda.CUDAGraph, pool: tuple[int, int], device: torch.device) -> Iterator[None]:
    """If recording `graph` in this block fails, leave the GPU usable. `pool` is the graph's memory."""
    stream, generator = torch.cuda.current_stream(device), torch.cuda.default_generators[device.index]
    random_state = generator.clone_state()
    try:
        yield
    except Exception:
        _failed.append(graph)
        torch.cuda.set_stream(stream)  # a failed recording leaves its stream the current one,
        generator.graphsafe_set_state(random_state)  # and its random state unusable
        with contextlib.suppress(RuntimeError):  # the recording may have ended already
            torch._C._cuda_endAllocateToPool(device.index, pool)
        graph.reset()  # frees its memory if the recording had ended
        raise
    finally:
        torch.cuda.synchronize()


def exactly(device: torch.device) -> contextlib.AbstractContextManager[object]:
    """In this block on a GPU, cuDNN gives the same bits every time, and float32 is not TensorFloat-32."""
    if device.type != "cuda":
        return contextlib.nullcontext()
    settings: contextlib.AbstractContextManager[object] = torch.backends.cudnn.flags(
        enabled=True, benchmark=False, deterministic=True, allow_tf32=False
    )
    return settings


@contextlib.contextmanager
def _waiting_raises() -> Iterator[None]:
    """Raise RuntimeError for operations that wait for the GPU: they cannot be recorded, and a failed recording
    would leave traces."""
    before = torch.cuda.get_sync_debug_mode()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyTorch calls this mode a prototype
        torch.cuda.set_sync_debug_mode("error")
        try:
            yield
        finally:
            torch.cuda.set_sync_debug_mode(before)
