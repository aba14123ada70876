"""Several processes that train one network together, as torchrun starts them.

    torchrun --nproc-per-node 2 --no-python bc-train --epochs 10

Each takes its part of every batch; their gradients are averaged; the first one, rank 0, writes.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import nn
from torch.distributed import ReduceOp, all_reduce, barrier, destroy_process_group, init_process_group
from torch.nn.parallel import DistributedDataParallel

from model.errors import RunError

Result = TypeVar("Result")


class FirstRankError(RunError):
    """Raised on the other ranks when rank 0 cannot go on."""


@dataclass(frozen=True)
class Group:
    """The processes that train together; usually one."""

    rank: int
    ranks: int
    device: torch.device

    @property
    def is_first(self) -> bool:
        return self.rank == 0

    def sum(self, *values: float) -> list[float]:
        """Sum each value over all ranks, which must all call this."""
        return self._reduce(values, ReduceOp.SUM)

    def any(self, *values: bool) -> list[bool]:
        """Whether each value is true on any rank; all must call this."""
        return [number > 0 for number in self._reduce(tuple(map(float, values)), ReduceOp.MAX)]

    def on_first_rank(self, action: Callable[[], Result]) -> Result | None:
        """Call `action` on rank 0, while the others wait, and return its result; None on the others. All must call
        this.

        If it fails, all fail, so that none waits for ever: rank 0 with its error, the others with FirstRankError.
        """
        result, error = None, None
        if self.is_first:
            try:
                result = action()
            except Exception as caught:
                if self.ranks == 1:
                    raise
                error = caught
        [has_failed] = self.any(error is not None)
        if error is not None:
            raise error
        if has_failed:
            raise FirstRankError("the first process has failed; its message gives the reason")
        return result

    def distributed(self, network: nn.Module) -> nn.Module:
        """The network with its gradients averaged over all ranks. Its buffers, such as the means of a batch
        normalisation, are each rank's own; those of rank 0 are kept."""
        return network if self.ranks == 1 else DistributedDataParallel(network, broadcast_buffers=False)

    def _reduce(self, values: tuple[float, ...], operation: ReduceOp.RedOpType) -> list[float]:
        if self.ranks == 1:
            return list(values)
        numbers = torch.tensor(values, dtype=torch.float64, device=self.device)
        all_reduce(numbers, operation)
        return [float(number) for number in numbers]


def rank_of_process() -> int:
    """The number of this process among those that torchrun has started; 0 without torchrun."""
    return int(os.environ.get("RANK", "0"))


def local_rank_of_process() -> int:
    """The number of this process among those of this computer."""
    return int(os.environ.get("LOCAL_RANK", "0"))


@contextlib.contextmanager
def group_of_processes(device: torch.device) -> Iterator[Group]:
    """The group that torchrun has started this process in, or this process alone."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Group(0, 1, device)
        return
    init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Group(torch.distributed.get_rank(), torch.distributed.get_world_size(), device)
        barrier()  # rank 0 may still write what the others would not wait for
    finally:
        destroy_process_group()
