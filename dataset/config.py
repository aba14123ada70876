"""The settings of an index."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, get_args

from tyro.conf import arg

from common.car import Camera
from common.recipe import IndexRecipe, Recipe
from dataset.prediction_targets import MAX_AHEAD_S
from dataset.steering_bins import BINS

CORRECTION_SIGNS: Final[Mapping[Camera, float]] = {"center": 0.0, "left": 1.0, "right": -1.0}
"""The cameras that are used by default, and the sign of the side correction in the labels of each."""

Alteration = Literal["blur", "brightness", "shadow"]
EpochAlteration = Literal[
    "move", "zoom", "turn", "contrast", "brightness", "colours", "mix", "shadow", "box", "noise"
]
EPOCH_ALTERATIONS: Final[tuple[EpochAlteration, ...]] = get_args(EpochAlteration)
"""The alterations that training may apply to every picture in every epoch."""
EARLIER_ALTERATIONS: Final = tuple(name for name in EPOCH_ALTERATIONS if name != "mix")
"""All alterations of version 0.3."""
Drives = Literal["all", "takeovers"]
Labels = Literal["auto", "as-recorded"]


@dataclass(frozen=True)
class IndexConfig:
    """How frames become balanced samples. Defaults that --recipe does not set are the original project's."""

    EARLIER: ClassVar[Mapping[str, Any]] = {"recipe": "original", "labels": "as-recorded"}
    """The values of the original project, and of earlier versions of the toolkit, which lacked these settings."""

    EARLIER_ONLY: ClassVar[Mapping[str, Any]] = {"viewpoints": 0}
    """Removed settings, and the only value of each that this version still reads."""

    RARE: ClassVar[str] = (
        "per_bin max_uses alter label_smooth_s label_shift_s speed_ahead_s block_s gap_s validation_share drives"
    )
    recipe: IndexRecipe = "people"
    """Defaults for learning from people, or the original project's."""
    bins: int = BINS
    """Equal steering bins over -1..1."""
    balance: Annotated[bool, arg(help_behavior_hint="(default: balanced)")] = True
    """Use every sample once; do not balance the bins."""
    per_bin: Annotated[Literal["mean", "median"] | int, arg(metavar="mean|median|N")] = "mean"
    """Samples in a bin: mean or median of the non-empty bins, or N."""
    max_uses: int = 10
    """How often a bin may use each picture or mirror image."""
    flip: Annotated[bool, arg(help_behavior_hint="(default: added)")] = True
    """Add no mirrored copies."""
    cameras: tuple[Camera, ...] = tuple(CORRECTION_SIGNS)
    """Cameras to train on."""
    side_correction: float = 0.2
    """Steering added for the left camera, subtracted for the right."""
    labels: Labels = "auto"
    """auto: smooth and shift people's steering, leave out crashes."""
    label_smooth_s: Annotated[float | None, arg(name="label-smooth", metavar="SECONDS")] = None
    """Average the steering over this time; 0: off."""
    label_shift_s: Annotated[float | None, arg(name="label-shift", metavar="SECONDS")] = None
    """Take the steering this much later; 0: off."""
    speed_ahead_s: Annotated[float, arg(name="speed-ahead", metavar="SECONDS")] = 0.5
    """For `bc-train --targets speed`: learn the speed this much later."""
    alter: tuple[Alteration | Literal["none"], ...] = ("blur", "brightness", "shadow")
    """Changes to copies, each with probability one half."""
    drives: Drives = "all"
    """Frames of drives: all, or takeovers only."""
    where: Annotated[str | None, arg(metavar="CONDITION")] = None
    """Condition on the frames to use, such as "speed_mph > 5"."""
    block_s: float = 10.0
    """Seconds in a block of the split."""
    gap_s: float = 1.0
    """Seconds of frames left out around a validation block."""
    validation_share: float = 0.2
    """Share of the frames held out, in whole blocks."""
    validation: Annotated[tuple[str, ...], arg(metavar="SESSION [SESSION ...]")] = ()
    """Hold out these whole sessions instead of blocks."""
    seed: int = 0
    """Same logs and seed, same index."""

    @classmethod
    def of(cls, recipe: Recipe) -> IndexConfig:
        return cls(**cls.EARLIER) if recipe == "original" else cls()

    def __post_init__(self) -> None:
        """Raises ValueError, which names the flag, for a value out of range."""
        is_per_bin = not isinstance(self.per_bin, int) or self.per_bin >= 1
        names_once = len(set(self.alter)) == len(self.alter) and ("none" not in self.alter or len(self.alter) == 1)
        ahead_s = self.speed_ahead_s
        checks = (
            ("--bins", self.bins, 1 <= self.bins <= 10_000, "1 to 10,000"),
            ("--max-uses", self.max_uses, self.max_uses >= 1, "at least 1"),
            ("--cameras", "", len(self.cameras) > 0, "at least one"),
            ("--per-bin", self.per_bin, is_per_bin, "mean, median, or a number of at least 1"),
            # a comparison with NaN is false
            ("--validation-share", self.validation_share, 0 <= self.validation_share < 1, "0 to less than 1"),
            ("--seed", self.seed, self.seed >= 0, "0 or more"),
            ("--block-s", self.block_s, 0.001 <= self.block_s <= 1e6, "0.001 to 1,000,000 seconds"),
            ("--gap-s", self.gap_s, 0 <= self.gap_s <= 1e6, "0 to 1,000,000 seconds"),
            ("--side-correction", self.side_correction, abs(self.side_correction) <= 2, "-2 to 2"),
            ("--label-smooth", self.label_smooth_s, 0 <= (self.label_smooth_s or 0) <= 60, "0 to 60 seconds"),
            ("--label-shift", self.label_shift_s, abs(self.label_shift_s or 0) <= 10, "-10 to 10 seconds"),
            ("--speed-ahead", ahead_s, 0 <= ahead_s <= MAX_AHEAD_S, f"0 to {MAX_AHEAD_S:g} seconds"),
            ("--alter", " ".join(self.alter), names_once, "each alteration once, or only none"),
        )
        for flag, value, is_valid, expected in checks:
            if not is_valid:
                raise ValueError(f"{flag} {value}: expected {expected}")

    @property
    def alterations(self) -> tuple[Alteration, ...]:
        return tuple(name for name in self.alter if name != "none")
