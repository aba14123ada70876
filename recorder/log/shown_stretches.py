"""What is odd in a recording, as its pictures show it, and no numbers."""

from __future__ import annotations

from functools import partial

from common.progress import progress_bar
from common.stretches import stretches
from recorder.log.odd_stretches import OddStretch, stretch_of
from recorder.log.reader import Log
from recorder.log.row_quality import States


def shown_stretches(log: Log) -> list[OddStretch]:
    """The stretches of a log that its centre camera's pictures, all decoded, show to be odd. Raises LogError for a
    log whose rows cannot be read."""
    from recorder.log.steering_against_pictures import against_pictures  # OpenCV

    states = States.of(log.vehicle())
    with progress_bar() as bar:
        task = bar.add_task("comparing steering with pictures", total=len(states.row), note="")
        against = against_pictures(log, partial(bar.advance, task))
    return [
        stretch_of(
            states, first, last, "steering_against_pictures", "the pictures turn the other way", is_sure=True
        )
        for first, last in stretches(against)
    ]
