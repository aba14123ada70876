"""The device of a training, its arithmetic, and the number of samples that it computes at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Final, Literal

import msgspec
import torch

from common.errors import UsageError, counted
from common.process_settings import keep_freed_memory, usable_cores
from model.config import Device, Precision, TrainConfig
from model.errors import RunError

_MOST_PER_CORE: Final = 16
"""Threads for each core. A run of a larger machine may be resumed with its number of threads, on which rounding
depends."""


@dataclass(frozen=True)
class ProcessorWay:
    """Settings of a training on processors with an instruction."""

    instruction: str  # as `torch.cpu.get_capabilities` names it; empty: every processor
    arithmetic: Literal["float32", "bfloat16"]
    micro_batch: int


PROCESSOR_WAYS: Final = (
    ProcessorWay("amx_bf16", "bfloat16", 128),
    ProcessorWay("avx512_bf16", "bfloat16", 64),
    ProcessorWay("bf16", "bfloat16", 64),  # Arm's
    ProcessorWay("", "float32", 64),
    ProcessorWay("", "bfloat16", 64),  # only with --precision bfloat16
)
"""A training uses the first row whose instruction the processor has. The table was measured
(benchmarks/README.md). A trial at the start of a training would not always give the same row, but the same machine
and seed must give the same weights.

Cores and caches do not matter: the first layer's output for 16 pictures is already larger than a core's cache, and
larger batches were a little faster. With AMX, larger batches gain more, because convolutions take less of the
time. A micro-batch of 256 would be a few percent faster still, and take 0.4 GB more."""


@dataclass(frozen=True)
class Machine:
    device: torch.device
    dtype: torch.dtype
    micro_batch: int

    @property
    def arithmetic(self) -> str:
        """The name of `dtype`: "bfloat16" or "float32"."""
        return str(self.dtype).removeprefix("torch.")


class _StoredMachine(msgspec.Struct):
    """The machine on which a run began, as its config.json stores it."""

    device: str
    arithmetic: Literal["float32", "bfloat16"]
    micro_batch: Annotated[int, msgspec.Meta(ge=1, le=10**9)]


def choose_machine(config: TrainConfig, begun: object = None) -> Machine:
    """The device, arithmetic and micro-batch for `config`.

    Automatic settings are chosen for the device. A resumed or repeated run keeps those of `begun` (the machine in
    its config.json) if the device is of the same kind and supports them. Raises RunError if this machine does not
    have the device, UsageError for many more threads than it has cores.
    """
    device = choose_device(config.device)
    if device.type == "cuda":
        torch.set_float32_matmul_precision("high")  # TF32 for float32
    else:
        keep_freed_memory()
    if config.threads:
        if config.threads > _MOST_PER_CORE * (cores := usable_cores()):
            most = f"at most {_MOST_PER_CORE * cores}, as this process has {counted(cores, 'core')}"
            raise UsageError(f"--threads {config.threads}: expected {most}; more are slower")
        torch.set_num_threads(config.threads)
    precision, micro_batch = config.precision, config.micro_batch
    stored = _stored_machine(begun, device)
    if stored is not None:
        micro_batch = micro_batch or stored.micro_batch
        is_supported = stored.arithmetic == "float32" or training_dtype("auto", device) == torch.bfloat16
        if precision == "auto" and is_supported:
            precision = stored.arithmetic
    if not micro_batch:
        is_cpu = device.type == "cpu"
        micro_batch = (
            processor_way(torch.cpu.get_capabilities(), precision).micro_batch if is_cpu else config.batch
        )
    return Machine(device, training_dtype(precision, device), micro_batch)


def choose_device(device: Device) -> torch.device:
    """The processor or the GPU, as `--device` says. Raises RunError for "cuda" if PyTorch finds no GPU."""
    has_gpu = torch.cuda.is_available()
    if device == "cuda" and not has_gpu:
        raise RunError("--device cuda: PyTorch finds no GPU; give --device cpu, or install PyTorch for CUDA")
    return torch.device("cuda:0" if device != "cpu" and has_gpu else "cpu")


def processor_way(capabilities: Mapping[str, object], precision: Precision = "auto") -> ProcessorWay:
    """The settings for a processor of these capabilities, in the requested arithmetic."""
    return next(
        way
        for way in PROCESSOR_WAYS
        if (not way.instruction or capabilities.get(way.instruction)) and precision in ("auto", way.arithmetic)
    )


def training_dtype(precision: Precision, device: torch.device) -> torch.dtype:
    """The arithmetic to train in on `device`."""
    if precision == "auto":
        if device.type == "cuda":
            precision = "bfloat16" if torch.cuda.is_bf16_supported(including_emulation=False) else "float32"
        else:
            precision = processor_way(torch.cpu.get_capabilities()).arithmetic
    return torch.bfloat16 if precision == "bfloat16" else torch.float32


def _stored_machine(begun: object, device: torch.device) -> _StoredMachine | None:
    """The machine `begun` from a run's config.json; None if it is invalid or has another kind of device."""
    try:
        stored = msgspec.convert(begun, _StoredMachine)
    except msgspec.ValidationError:
        return None
    return stored if stored.device == device.type else None
