"""The verdict on a network as a badge and one sentence; its numbers are in the verdict itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

from common.errors import printable

if TYPE_CHECKING:
    from model.runs.run_summary import RunSummary


class Badge(NamedTuple):
    word: Literal["drives", "perhaps", "not yet"]
    sentence: str
    kind: Literal["good", "", "bad"]  # of its colour


def badge_of(run: RunSummary | None) -> Badge | None:
    """None for a run that is not read yet, or that was not measured."""
    if run is None or (verdict := run.verdict) is None:
        return None
    band = verdict.drivable.band
    like = (
        f"{band.stayed} of {band.networks} networks as good as this one stayed on the built-in roads"
        if band
        else ""
    )
    match verdict.in_short:
        case "drives":
            return Badge("drives", f"It {printable(verdict.driven)}.", "good")
        case "leaves the road":
            return Badge("not yet", f"It {printable(verdict.driven)}.", "bad")
        case "enough":
            return Badge("drives", f"It should stay on the road: {like}.", "good")
        case "perhaps":
            return Badge("perhaps", f"Perhaps it stays on the road{f': {like}' * bool(like)}. Let it try.", "")
        case "too weak":
            return Badge("not yet", f"It needs to learn more: {like}.", "bad")
        case "no better":
            return Badge(
                "not yet", "It needs to learn more: it is no better than steering always the same.", "bad"
            )
    return None
