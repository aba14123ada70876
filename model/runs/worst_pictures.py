"""The held-out frames with the largest errors after each epoch, with their pictures.

runs/NAME/worst.jsonl   one line of JSON an epoch (in very long trainings, the last ones). Pictures are in base64,
                        so that they can be shown without the index.
"""

from __future__ import annotations

import base64
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from common.steering_unit import SteeringUnit, assumed_deg
from dataset import MAX_STEERING_DEG

if TYPE_CHECKING:
    import pyarrow as pa

    from dataset import Loader
    from dataset.preprocessing import Image

WORST_FILE: Final = "worst.jsonl"
"""One line an epoch: `WorstPictures.as_dict`."""
MAX_WORST_BYTES: Final = 32 << 20
"""Size limit of worst.jsonl: some 500 epochs. A longer training keeps its last ones."""
WORST_COUNT: Final = 6
WORST_COLUMNS: Final = ("session", "row", "log_time_ns")
"""Columns that the table of the frames held out must have."""

_QUALITY: Final = 90  # of the JPEGs, some 7 KB each
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


@dataclass(frozen=True)
class WorstPictures:
    """The worst frames after an epoch, the worst first, and the crop that the network saw of each, as a JPEG."""

    epoch: int  # from 1
    frames: tuple[WorstFrame, ...]
    jpegs: tuple[bytes, ...]
    max_deg: float | None = MAX_STEERING_DEG  # the wheels' angle at steering 1; None: unknown

    def as_dict(self) -> dict[str, Any]:
        frames = [
            {**asdict(frame), "jpeg": base64.b64encode(jpeg).decode()}
            for frame, jpeg in zip(self.frames, self.jpegs, strict=True)
        ]
        steering = {"max_deg": self.max_deg} if self.max_deg != MAX_STEERING_DEG else {}
        return {"epoch": self.epoch, **steering, "frames": frames}


def find_worst(
    epoch: int,
    measured: pa.Table,
    loader: Loader,
    predicted: NDArray[np.float64],
    recorded: NDArray[np.float64],
    max_deg: float | None = MAX_STEERING_DEG,
) -> WorstPictures:
    """The frames with the largest errors among those that a network was measured on.

    `measured` has `WORST_COLUMNS` for each sample of `loader`. The steering arrays (N,) have the samples whose
    pictures decode. `max_deg` is the wheels' angle at steering 1, None if unknown.
    """
    import pyarrow as pa  # imported late: `bc-runs` starts without it

    from dataset.preprocessing import as_bgr

    decoded = np.flatnonzero(loader.decoded)
    frames = measured.take(decoded).append_column("predicted", pa.array(predicted))
    frames = frames.append_column("recorded", pa.array(recorded))
    worst = worst_frames(frames, min(WORST_COUNT, loader.batch), max_deg)
    time_ns, row = (frames[name].to_numpy() for name in ("log_time_ns", "row"))
    samples = [
        decoded[
            np.argmax(
                (time_ns == frame.log_time_ns)
                & (row == frame.row)
                & (assumed_deg(max_deg) * predicted == frame.predicted_deg)
            )
        ]
        for frame in worst
    ]
    pictures = loader.pictures_of(np.array(samples, np.int64)) if samples else ()
    return WorstPictures(
        epoch, tuple(worst), tuple(_jpeg(as_bgr(picture, loader.seen)) for picture in pictures), max_deg
    )


def _jpeg(crop: Image) -> bytes:
    import cv2

    return cv2.imencode(".jpg", crop, (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))[1].tobytes()


def worst_frames(frames: pa.Table, count: int, max_deg: float | None = MAX_STEERING_DEG) -> list[WorstFrame]:
    """The `count` frames with the largest errors, the largest first. Frames of a session are at least a second
    apart, so that they show different moments. `frames` has the columns of `Evaluation.frames`. `max_deg` is the
    wheels' angle at steering 1."""
    session = frames["session"].combine_chunks().dictionary_encode().indices.to_numpy()
    columns = ("log_time_ns", "row", "predicted", "recorded")
    time_ns, row, predicted, recorded = (frames[name].to_numpy() for name in columns)
    taken: dict[tuple[int, int], int] = {}  # chosen log times in ns, by session and whole second
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
