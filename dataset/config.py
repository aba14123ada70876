"""What an index is made with."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from dataset.alter import Alteration
from recorder.topics import Camera


@dataclass(frozen=True)
class IndexConfig:
    """How frames become balanced samples. The defaults are those of the original project."""

    bins: int = 25
    """Equal steering bins over -1..1."""
    max_uses: int = 10
    """Cap: how often one picture may be used to fill up its bin, itself included."""
    flip: bool = True
    """Mirrored copies of every picture, their steering negated; --no-flip leaves them out."""
    cameras: tuple[Camera, ...] = ("center", "left", "right")
    """The cameras to train on."""
    side_correction: float = 0.2
    """Added to the steering of the left camera's pictures, taken from that of the right one's."""
    alter: tuple[Alteration, ...] = ("blur", "brightness", "shadow")
    """What a filling copy may get, each with probability one half; empty: copies are repeated as they are."""
    block_s: float = 10.0
    """Length in seconds of the blocks of time that are split between training and validation."""
    validation: float = 0.2
    """Share of the frames held out for validation, in whole blocks."""
    seed: int = 0
    """Everything random here is drawn from it: same logs, same seed, same index."""

    def __post_init__(self) -> None:
        """Raises ValueError for a value that makes no sense."""
        if self.bins < 1 or self.max_uses < 1 or not self.cameras:
            raise ValueError("bins and max_uses must be at least 1, and cameras must name at least one")
        if not 0 <= self.validation < 1 or self.block_s <= 0 or self.seed < 0:
            raise ValueError("validation must be in 0..1 (1 excluded), block_s positive, seed not negative")

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)
