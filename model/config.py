"""The settings of a training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

from common.recipe import Recipe
from dataset.prediction_targets import STEERING_ONLY, TargetName, check_targets
from model.network.names import check_network_name

Device = Literal["auto", "cpu", "cuda"]
Precision = Literal["auto", "float32", "bfloat16"]
Answers = Literal["natural", "as-learnt"]
Keep = Literal["driving-error", "balanced-rmse", "rmse", "last"]

_RANGES: Final = {
    "epochs": (1, 10**6),
    "batch": (1, 10**6),
    "average_steps": (1, 10**6),
    "seed": (0, 2**63 - 1),
    "patience": (0, 10**9),
    "micro_batch": (0, 10**9),
    "threads": (0, 4096),
    "picture_memory_mb": (0, 10**9),
}


@dataclass(frozen=True)
class TrainConfig:
    """The settings of a training. Those that are not of the recipe are the original project's."""

    EARLIER: ClassVar[Mapping[str, Any]] = {
        "recipe": "original",
        "average_steps": 1,
        "answers": "as-learnt",
        "keep": "balanced-rmse",
    }
    """Settings of the original project, and of earlier versions of this one, which lacked these fields."""

    recipe: Recipe = "people"
    """Defaults: people: what learns best from people (--average-steps, --answers, --keep); original: as the
    original project did."""
    network: str = "original"
    """original, pilotnet, small, resnet18, or one of your own: FILE.py:CLASS or package.module:CLASS."""
    network_args: tuple[str, ...] = ()
    """Arguments of a network of your own: NAME=VALUE."""
    targets: tuple[TargetName, ...] = STEERING_ONLY
    """What the network learns to answer: steering; and speed, which is then driven, never above bc-drive's
    --speed, or throttle, which is sent as it is."""
    target_weights: tuple[float, ...] = ()
    """How much the squared error of each target counts; by default, each 1. 1 of speed is 30 mph."""
    picture_px: tuple[int, int] | None = None
    """Width and height of what the network sees; by default, its own: 128 128 for the original."""
    crop_rows: tuple[int, int] | None = None
    """Rows cut off the top and the bottom of a picture of 160 rows, of others the same share; by default 50 20."""
    channels: Literal["BGR", "RGB", "YUV"] | None = None
    """Order of the colours that the network sees; by default, its own: BGR for the original."""
    epochs: int = 10
    """Passes over the balanced training samples."""
    batch: int = 256
    """Samples in one step of the optimizer."""
    rate: float = 1e-4
    """Learning rate of Adam."""
    average_steps: int = 100
    """The weights that are measured, kept, and drive are the mean over about so many steps; 1: the latest."""
    answers: Answers = "natural"
    """natural: undo in the network's answers that hard steering was balanced up; as-learnt: leave them so."""
    keep: Keep = "driving-error"
    """The epoch that is kept, and drives: that of the smallest error on the frames held out, where every steering
    bin counts alike (driving-error: with the correlation, which predicts best how a network drives) or every frame
    does; or the last one."""
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
    """Samples that go through the network at once, for the same result but for rounding; 0: 128 on a processor
    with AMX, 64 on another, on a GPU all."""
    threads: int = 0
    """Processor threads; 0: as many as there are cores. Beside other programs one may be three times as fast as
    two."""
    picture_memory_mb: int = 1024
    """Memory for decoded pictures; those beyond it are decoded anew in each epoch."""

    @classmethod
    def of(cls, recipe: Recipe) -> TrainConfig:
        """The defaults of a recipe."""
        return cls(**cls.EARLIER) if recipe == "original" else cls()

    def __post_init__(self) -> None:
        """Raises ValueError, naming the flag, for a value that makes no sense."""
        for name, (least, most) in _RANGES.items():
            value = getattr(self, name)
            if not least <= value <= most:
                flag = name.replace("_", "-")
                raise ValueError(f"--{flag} {value}: a whole number from {least:,} to {most:,} was expected")
        check_network_name(self.network)
        if bad := [each for each in self.network_args if not each.partition("=")[0].isidentifier()]:
            raise ValueError(f"--network-args {bad[0]}: NAME=VALUE was expected")
        try:
            check_targets(self.targets)
        except ValueError as error:
            raise ValueError(f"--{error}") from None
        if self.target_weights and len(self.target_weights) != len(self.targets):
            raise ValueError(
                f"--target-weights {' '.join(f'{each:g}' for each in self.target_weights)}: one for each of"
                f" {', '.join(self.targets)} was expected"
            )
        if not all(0 <= each < math.inf for each in self.target_weights) or sum(self.target_weights or (1,)) <= 0:
            raise ValueError("--target-weights: numbers of 0 or more, not all 0, were expected")
        if self.keep == "last" and self.patience:
            raise ValueError(f"--patience {self.patience}: with --keep last no epoch is better than a later one")
        if not 0 < self.rate < math.inf:
            raise ValueError(f"--rate {self.rate:g}: a number above 0 was expected")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"--dropout {self.dropout:g}: a number from 0 to 1 (excluded) was expected")
