"""The device that a training computes on, its arithmetic, and how much goes through the network at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch

from common.memory_allocator import keep_freed_memory
from model.config import Precision, TrainConfig
from model.errors import RunError

CPU_MICRO_BATCH: Final = 64
"""As fast as the whole batch of 256 at once, in half the memory."""


@dataclass(frozen=True)
class Machine:
    device: torch.device
    dtype: torch.dtype
    micro_batch: int

    @property
    def arithmetic(self) -> str:
        """Its name: "bfloat16" or "float32"."""
        return str(self.dtype).removeprefix("torch.")


def choose_machine(config: TrainConfig, local_rank: int = 0) -> Machine:
    """The machine that `config` asks for; `local_rank` is this process's number among those of its computer.

    Raises RunError if there is no such device here.
    """
    has_gpu = torch.cuda.is_available()
    if config.device == "cuda" and not has_gpu:
        raise RunError("--device cuda: PyTorch finds no GPU here; give --device cpu, or install PyTorch for CUDA")
    if config.device != "cpu" and has_gpu:
        if local_rank >= torch.cuda.device_count():
            raise RunError(f"{torch.cuda.device_count()} GPUs here: give torchrun no greater --nproc-per-node")
        device = torch.device("cuda", local_rank)
        torch.cuda.set_device(device)
        torch.set_float32_matmul_precision("high")  # TF32 where float32 is asked for
        torch.backends.cudnn.benchmark = True  # one shape again and again: the fastest kernel is worth a search
    else:
        device = torch.device("cpu")
        keep_freed_memory()
    if config.threads:
        torch.set_num_threads(config.threads)
    dtype = training_dtype(config.precision, device)
    micro_batch = config.micro_batch or (CPU_MICRO_BATCH if device.type == "cpu" else config.batch)
    return Machine(device, dtype, micro_batch)


def training_dtype(precision: Precision, device: torch.device) -> torch.dtype:
    """The arithmetic to train in on `device`."""
    if precision != "auto":
        return torch.bfloat16 if precision == "bfloat16" else torch.float32
    if device.type == "cuda":
        has_bfloat16 = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        capabilities = torch.cpu.get_capabilities()
        has_bfloat16 = any(capabilities.get(name) for name in ("avx512_bf16", "amx_bf16", "bf16"))
    return torch.bfloat16 if has_bfloat16 else torch.float32
