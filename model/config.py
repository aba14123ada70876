"""The settings of a training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Literal

from common.recipe import Recipe
from dataset.config import EPOCH_ALTERATIONS, EpochAlteration
from dataset.prediction_targets import STEERING_ONLY, TargetName, check_targets
from model.network.names import check_network_name

Device = Literal["auto", "cpu", "cuda"]
Precision = Literal["auto", "float32", "bfloat16"]
Answers = Literal["natural", "as-learnt"]
Light = Literal["standardized", "as-seen"]
Keep = Literal["last", "driving-error", "balanced-rmse", "rmse"]

ENOUGH_STEPS: Final = 150
"""After so many steps, a network drives (docs/studies/speedrun.md)."""
_MOST_PASSES: Final = 10
"""Recordings that are so short that they would need more passes lack other things than passes."""
_SMALL_STEPS: Final[Mapping[str, Any]] = {"epochs": 10, "batch": 256, "rate": 1e-4}
"""Settings of the original project, which the recipes `altered` and `people` keep."""

_RANGES: Final = {
    "epochs": (0, 10**6),
    "batch": (1, 10**6),
    "average_steps": (1, 10**6),
    "seed": (0, 2**63 - 1),
    "patience": (0, 10**9),
    "micro_batch": (0, 10**9),
    "threads": (0, 4096),
    "picture_memory_mb": (0, 10**9),
}


def enough_passes(samples: int, batch: int) -> int:
    """The passes over so many samples after which a network has learnt in enough steps."""
    steps = math.ceil(samples / batch) or 1
    return min(_MOST_PASSES, math.ceil(ENOUGH_STEPS / steps))


@dataclass(frozen=True)
class TrainConfig:
    """The settings of a training. Defaults that --recipe does not set are the original project's."""

    EARLIER: ClassVar[Mapping[str, Any]] = {
        "recipe": "original",
        **_SMALL_STEPS,
        "average_steps": 1,
        "answers": "as-learnt",
        "keep": "balanced-rmse",
        "alter_each_epoch": ("none",),
        "light": "as-seen",
    }
    """Settings of the original project. Earlier versions of the toolkit trained with them and did not store
    them."""

    RARE: ClassVar[str] = (
        "network_args target_weights picture_px crop_rows channels average_steps"
        " answers keep light dropout precision micro_batch threads picture_memory_mb"
    )
    recipe: Recipe = "large-steps"
    """Defaults: large-steps; earlier ones, with altered pictures or without; or the original project's."""
    network: str = "original"
    """original, pilotnet, small, resnet18, FILE.py:CLASS or MODULE:CLASS."""
    network_args: tuple[str, ...] = ()
    """Arguments of your own network: NAME=VALUE."""
    targets: tuple[TargetName, ...] = STEERING_ONLY
    """What the network learns: steering, also speed or throttle."""
    target_weights: tuple[float, ...] = ()
    """Weight of each target's squared error (speed in units of 30 mph); by default 1."""
    picture_px: tuple[int, int] | None = None
    """Width and height of the network's picture."""
    crop_rows: tuple[int, int] | None = None
    """Rows of 160 cut off at top and bottom."""
    channels: Literal["BGR", "RGB", "YUV"] | None = None
    """Colour order of the network's picture."""
    alter_each_epoch: tuple[EpochAlteration | Literal["all", "none"], ...] = ("all",)
    """Random changes to every picture in every epoch: all, or some."""
    light: Light = "standardized"
    """Brightness and contrast of pictures: the same in all, or as seen. Your own network sees them as they are."""
    epochs: int = 0
    """Passes over the balanced samples; 0: 1 to 10, enough for 150 steps."""
    batch: int = 64
    """Samples in a step of the optimizer."""
    rate: float = 1e-3
    """Learning rate of Adam."""
    average_steps: int = 100
    """Average the weights over about this many steps; 1: off."""
    answers: Answers = "natural"
    """natural: undo the balancing's effect on answers."""
    keep: Keep = "last"
    """Keep the last epoch, or that with the smallest of these errors."""
    dropout: float = 0.5
    """Share of activations that dropout zeroes."""
    seed: int = 0
    """Seed of weights, dropout and the order of samples."""
    patience: int = 0
    """Stop after this many epochs without progress; 0: never. Not with --keep last."""
    device: Device = "auto"
    """auto: a GPU if there is one."""
    precision: Precision = "auto"
    """Arithmetic; auto: bfloat16 if the device has it."""
    micro_batch: int = 0
    """Samples computed at once; 0: chosen for the device."""
    threads: int = 0
    """Threads; 0: one a core. Fewer are faster on a busy machine."""
    picture_memory_mb: int = 1024
    """Memory for decoded pictures; others are decoded every epoch."""

    @classmethod
    def of(cls, recipe: Recipe) -> TrainConfig:
        if recipe == "original":
            return cls(**cls.EARLIER)
        if recipe == "large-steps":
            return cls()
        altered = cls(recipe="altered", **_SMALL_STEPS)
        if recipe == "altered":
            return altered
        return replace(altered, recipe=recipe, keep="driving-error", alter_each_epoch=("none",), light="as-seen")

    def __post_init__(self) -> None:
        """Raises ValueError, which names the flag, for an invalid value."""
        for name, (minimum, maximum) in _RANGES.items():
            value = getattr(self, name)
            if not minimum <= value <= maximum:
                flag = name.replace("_", "-")
                raise ValueError(f"--{flag} {value}: expected a whole number from {minimum:,} to {maximum:,}")
        check_network_name(self.network)
        if bad := [argument for argument in self.network_args if not argument.partition("=")[0].isidentifier()]:
            raise ValueError(f"--network-args {bad[0]}: expected NAME=VALUE")
        try:
            check_targets(self.targets)
        except ValueError as error:
            raise ValueError(f"--{error}") from None
        if self.target_weights and len(self.target_weights) != len(self.targets):
            raise ValueError(
                f"--target-weights {' '.join(f'{weight:g}' for weight in self.target_weights)}: expected one for"
                f" each of {', '.join(self.targets)}"
            )
        weights = self.target_weights or (1,)
        if not all(0 <= weight < math.inf for weight in weights) or sum(weights) <= 0:
            raise ValueError("--target-weights: expected numbers of 0 or more, not all 0")
        if self.keep == "last" and self.patience:
            raise ValueError(
                f"--patience {self.patience}: not with --keep last, which prefers every new epoch; a new"
                " training can have --keep driving-error as well"
            )
        names = self.alter_each_epoch
        if len(set(names)) < len(names) or (len(names) > 1 and {"all", "none"}.intersection(names)):
            raise ValueError(f"--alter-each-epoch {' '.join(names)}: expected each once, or only all or none")
        if not 0 < self.rate < math.inf:
            raise ValueError(f"--rate {self.rate:g}: expected a number above 0")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"--dropout {self.dropout:g}: expected a number from 0 to 1 (excluded)")

    def with_passes(self, samples: int) -> TrainConfig:
        """These settings with a number of epochs, if they leave it open, for an index with so many training
        samples."""
        return self if self.epochs else replace(self, epochs=enough_passes(samples, self.batch))

    @property
    def epoch_alterations(self) -> tuple[EpochAlteration, ...]:
        """The alterations of every picture in every epoch."""
        names = self.alter_each_epoch
        return EPOCH_ALTERATIONS if "all" in names else tuple(name for name in EPOCH_ALTERATIONS if name in names)
