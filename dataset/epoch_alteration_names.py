"""The names of the alterations that every picture may have in every epoch, for flags."""

from __future__ import annotations

from typing import Final, Literal, get_args

EpochAlteration = Literal["move", "zoom", "turn", "contrast", "brightness", "colours", "shadow", "box", "noise"]
EPOCH_ALTERATIONS: Final[tuple[EpochAlteration, ...]] = get_args(EpochAlteration)
