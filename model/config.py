"""What a training is made with."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

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
    precision: Precision = "auto"
    """Arithmetic of the forward and backward pass; auto: bfloat16 where the processor has it."""
    threads: int = 0
    """Processor threads; 0: as many as there are cores."""
    picture_memory_mb: int = 1024
    """Memory for decoded pictures; those beyond it are decoded anew in each epoch."""

    def __post_init__(self) -> None:
        """Raises ValueError for a value that makes no sense."""
        if self.epochs < 1 or self.batch < 1 or not self.rate > 0 or not 0 <= self.dropout < 1:
            raise ValueError("epochs and batch must be at least 1, rate positive, dropout in 0..1 (1 excluded)")
        if self.seed < 0 or self.threads < 0 or self.picture_memory_mb < 0:
            raise ValueError("seed, threads and picture_memory_mb must not be negative")

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)
