"""What a training is made with."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

Device = Literal["auto", "cpu", "cuda"]
Precision = Literal["auto", "float32", "bfloat16"]


@dataclass(frozen=True)
class TrainConfig:
    """How the network is trained. The defaults are those of the original project."""

    epochs: int = 10
    """Passes over the balanced training samples."""
    batch: int = 256
    """Samples in one step of the optimizer."""
    rate: float = 1e-4
    """Learning rate of Adam."""
    dropout: float = 0.5
    """Share of the activations that dropout sets to zero, before each of the two widest layers."""
    seed: int = 0
    """Weights, dropout and the order of samples are drawn from it."""
    patience: int = 0
    """Stop when so many epochs in a row have not bettered the best one; 0: train all epochs."""
    device: Device = "auto"
    """Where to compute; auto: on the GPU if there is one."""
    precision: Precision = "auto"
    """Arithmetic of the forward and backward pass; auto: bfloat16 where the device has it."""
    micro_batch: int = 0
    """Samples that go through the network at once, for the same result; 0: 64 on a processor, on a GPU all."""
    threads: int = 0
    """Processor threads; 0: as many as there are cores."""
    picture_memory_mb: int = 1024
    """Memory for decoded pictures; those beyond it are decoded anew in each epoch."""

    def __post_init__(self) -> None:
        """Raises ValueError for a value that makes no sense."""
        if not (1 <= self.epochs <= 10**6 and 1 <= self.batch <= 10**6):
            raise ValueError("epochs and batch must be in 1..1,000,000")
        if not 0 < self.rate < math.inf or not 0 <= self.dropout < 1:
            raise ValueError("rate must be positive, dropout in 0..1 (1 excluded)")
        if not (0 <= self.seed < 2**63 and 0 <= self.threads <= 4096):
            raise ValueError("seed must be in 0..2^63 (excluded), threads in 0..4,096")
        numbers = (self.patience, self.micro_batch, self.picture_memory_mb)
        if not all(0 <= number <= 10**9 for number in numbers):
            raise ValueError("patience, micro_batch and picture_memory_mb must be in 0..10^9")

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)
