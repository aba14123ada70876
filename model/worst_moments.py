"""The moments at which a network is off the most."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Final

import numpy as np

from common.steering_unit import SteeringUnit, assumed_deg
from dataset import MAX_STEERING_DEG

if TYPE_CHECKING:
    import pyarrow as pa

_APART_NS: Final = 1_000_000_000
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class WorstFrame:
    session: str
    row: int
    log_time_ns: int
    log_time_utc: str  # ISO 8601, to the millisecond
    predicted_deg: float
    recorded_deg: float
    error_deg: float  # predicted - recorded: positive is too far to the right

    def in_words(self, unit: SteeringUnit) -> str:
        """ "3.2 degrees too far to the left: -1.2 predicted, 2.0 recorded"."""
        error, predicted, recorded = map(unit.of, (self.error_deg, self.predicted_deg, self.recorded_deg))
        side = "right" if error > 0 else "left"
        off = f"{abs(error):.1f} {unit.name} too far to the {side}"
        return f"{off}: {predicted:z.1f} predicted, {recorded:z.1f} recorded"


def worst_frames(frames: pa.Table, count: int, max_deg: float | None = MAX_STEERING_DEG) -> list[WorstFrame]:
    """The `count` frames with the largest errors, the largest first; those of a session at least a second apart,
    so that they are different moments. `frames` has the columns of `Evaluation.frames`. `max_deg` is the
    wheels' angle at steering 1."""
    session = frames["session"].combine_chunks().dictionary_encode().indices.to_numpy()
    columns = ("log_time_ns", "row", "predicted", "recorded")
    time_ns, row, predicted, recorded = (frames[name].to_numpy() for name in columns)
    taken: dict[tuple[int, int], int] = {}  # times, by session and whole second
    worst: list[WorstFrame] = []
    for at in np.argsort(-np.abs(predicted - recorded), kind="stable").tolist():
        if len(worst) == count:
            break
        drive, now_ns = int(session[at]), int(time_ns[at])
        near = (taken.get((drive, now_ns // _APART_NS + step)) for step in (-1, 0, 1))
        if all(other is None or abs(other - now_ns) >= _APART_NS for other in near):
            taken[drive, now_ns // _APART_NS] = now_ns
            predicted_deg, recorded_deg = (
                assumed_deg(max_deg) * float(steering[at]) for steering in (predicted, recorded)
            )
            worst.append(
                WorstFrame(
                    frames["session"][at].as_py(),
                    int(row[at]),
                    now_ns,
                    (_EPOCH + timedelta(microseconds=now_ns // 1000)).isoformat(timespec="milliseconds"),
                    predicted_deg,
                    recorded_deg,
                    predicted_deg - recorded_deg,
                )
            )
    return worst
