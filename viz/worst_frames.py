"""The frames held out at which a network was off the most after each epoch, with its picture and steering."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from common.steering_unit import SteeringUnit, assumed_deg, steering_unit
from dataset.preprocessing import decode
from model.runs.worst_pictures import WORST_COUNT, WorstPictures
from model.worst_moments import WorstFrame
from viz.playback.blueprint import BLUE, ORANGE
from viz.playback.curves import arcs

WORST: Final = "/worst"
_ARCS: Final = (("recorded", BLUE, 2.5), ("predicted", ORANGE, 2.0))  # name, colour, half the width


def worst_views() -> rrb.Container:
    """A view for each of the worst frames, and their description."""
    views = [
        rrb.Spatial2DView(origin=f"{WORST}/{number}", name=f"worst {number}")
        for number in range(1, WORST_COUNT + 1)
    ]
    words = rrb.TextDocumentView(origin=f"{WORST}/words", name="worst frames held out")
    return rrb.Vertical(rrb.Grid(*views, grid_columns=3), words, row_shares=[2, 1])


def send_worst(recording: rr.RecordingStream, worst: WorstPictures, times: Sequence[tuple[str, int]]) -> None:
    """Send those of one epoch: `times` are the names of time lines and where the epoch ends on them."""
    for line, at in times:
        recording.set_time(line, sequence=at)
    for number, (frame, jpeg) in enumerate(zip(worst.frames, worst.jpegs, strict=True), 1):
        entity = f"{WORST}/{number}"
        recording.log(entity, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        height, width = decode(jpeg).shape[:2]
        for name, color, radius in _ARCS:
            steering = np.array([getattr(frame, f"{name}_deg") / assumed_deg(worst.max_deg)])
            arc = arcs(steering, (width, height))
            recording.log(f"{entity}/{name}", rr.LineStrips2D(arc, colors=[color], radii=[-radius]))
    for number in range(len(worst.frames) + 1, WORST_COUNT + 1):  # of the epoch before
        recording.log(f"{WORST}/{number}", rr.Clear(recursive=True))
    words = "\n".join(
        f"{number}. {_in_words(frame, steering_unit(worst.max_deg))}"
        for number, frame in enumerate(worst.frames, 1)
    )
    recording.log(f"{WORST}/words", rr.TextDocument(f"epoch {worst.epoch}\n{words}"))


def _in_words(frame: WorstFrame, unit: SteeringUnit) -> str:
    return f"{frame.session} row {frame.row}: {frame.in_words(unit)}"
