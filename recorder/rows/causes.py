"""The causes for which rows of a log, or their pictures, are odd or set apart: one table for every command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


class Cause(NamedTuple):
    """A cause. Logs, indexes and addresses of pages hold its name."""

    name: str
    title: str
    several: str = ""  # as `bc-log check` counts its stretches; empty: it does not
    is_sure: bool = False  # otherwise, a person has to look at the rows
    is_learnt: bool = True  # False: left out of training by default

    @property
    def of_frames(self) -> str:
        """In "12 frames of ..."."""
        return self.several.removeprefix("stretches of ")


_ROWS: Final = (
    Cause("gap", "gap in time"),
    Cause("out_of_range", "values out of range", "stretches of values out of range", is_sure=True),
    Cause("standing_still", "standing"),
    Cause("stuck_steering", "steering that never changes", "stretches of stuck steering"),
    Cause("crash", "crash", "crashes", is_sure=True, is_learnt=False),
    Cause("backwards", "driving backwards", "stretches of driving backwards", is_sure=True, is_learnt=False),
    Cause("manoeuvring", "manoeuvres", "manoeuvres around these", is_learnt=False),
    Cause("parked", "parked", "stretches of a parked car", is_sure=True, is_learnt=False),
)
_OTHER_STRETCHES: Final = (
    Cause("off_road", "off the road", is_sure=True),
    Cause("leaving_the_road", "leaving the road", is_sure=True),
    Cause("weaving", "weaving at full lock"),
    Cause("wheel_off_the_road", "a wheel off the road", is_sure=True),
    Cause("coasting", "coasting to a halt"),
    Cause("creeping", "creeping"),
)
_PICTURES: Final = (
    Cause("missing_picture", "missing picture"),
    Cause("broken_picture", "broken picture", is_sure=True),
    Cause("frozen_picture", "frozen picture"),
    Cause(
        "steering_against_pictures",
        "steering against the pictures",
        "stretches of steering against the pictures",
        is_sure=True,
    ),
)

CAUSES: Final[Mapping[str, Cause]] = {cause.name: cause for cause in (*_ROWS, *_OTHER_STRETCHES, *_PICTURES)}
ROW_FLAGS: Final = tuple(cause.name for cause in _ROWS)
"""The flags of a log's rows (`row_quality`)."""
PICTURE_FLAGS: Final = tuple(cause.name for cause in _PICTURES)
NOT_LEARNT: Final = tuple(cause.name for cause in _ROWS if not cause.is_learnt)
"""Rows with one of these are left out of training by default. For rows with several, the first counts."""
PLAIN: Final = ("standing_still", "manoeuvring")
"""Not odd: ordinary stops, and driving out of crashes."""
