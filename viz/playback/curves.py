"""Drawings of a log: curves, arcs over the frame, histogram, path, driver, events."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
import rerun as rr
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from numpy.typing import NDArray

from dataset.steering_bins import BINS, bin_of
from model.evaluation.log_predictions import LogPredictions
from recorder.pictures.picture_size import decoding_problem, width_and_height
from recorder.topics import EVENTS, PILOT_COMMAND, POSE, STEERING, TOPICS, VEHICLE
from viz.playback.blueprint import (
    ARCS,
    BLUE,
    CAR,
    CENTER,
    COLORS,
    DRIVEN_SPEED,
    DRIVER,
    DRIVERS,
    ERRORS,
    HISTOGRAM,
    PATH,
    Curve,
)
from viz.timelines import Clock, Times

Values = NDArray[np.float64]
Numbers = Mapping[str, Values]  # values (N,) of N messages, by the name of the field

_FRAME: Final = (320, 160)  # width and height of the simulator's pictures
_ALONG: Final = np.linspace(0, 1, 9)  # positions along an arc
_STRIPS: Final = pa.list_(
    pa.field("item", pa.list_(pa.field("item", pa.float32(), nullable=False), 2), nullable=False)
)
_POSE_FIELDS: Final = (
    *(f"pose.position.{axis}" for axis in "xyz"),  # m
    *(f"pose.orientation.{axis}" for axis in "xyzw"),  # a quaternion
)
_CAR_M: Final = 8.0  # length of the arrow that is the car, seen from above
_PATH_COLOR: Final = (110, 150, 110)
MAX_PATH_POINTS: Final = 2000  # a longer path keeps every second point
# the names of Rerun's MCAP reader
_LEVELS: Final = {
    LogMessage.Level.DEBUG: "DEBUG",
    LogMessage.Level.INFO: "INFO",
    LogMessage.Level.WARNING: "WARN",
    LogMessage.Level.ERROR: "ERROR",
    LogMessage.Level.FATAL: "CRITICAL",
}


_RUN_COLORS: Final = (
    (240, 90, 190), (240, 220, 90), (90, 220, 220), (170, 120, 240), (230, 90, 90), (150, 200, 80),
)  # fmt: skip


class Drawing:
    """Draws messages in a recording, one row a message: a whole log at once, or new messages of a growing log.

    Call `finish` at the end, or from time to time, for the drawings of all messages until then.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        clock: Clock,
        prefix: str = "",
        name: str = "",
        color: tuple[int, int, int] | None = None,
    ) -> None:
        """Entities get `prefix` before their paths. If several logs are shown, their speeds share a view, and
        their paths too: `name` and `color` distinguish them there."""
        self.picture_size = _FRAME
        self._recording = recording
        self._prefix = prefix
        self.clock = clock
        self._name = name
        self._color = color
        self._styled: set[str] = set()
        self._counts = np.zeros(BINS, np.int64)
        self._trail = Trail()
        self._driver: int | None = None
        self._has_new = False

    def send(self, topic: str, time_ns: Times, contents: Sequence[Any]) -> None:
        """Draw messages of one topic: log times (N,) in ns, and N contents."""
        if topic == EVENTS:
            self._events(time_ns, contents)
        else:
            numbers = numbers_of(topic, contents)
            self.send_numbers(topic, time_ns, numbers)
            self.send_arcs(topic, time_ns, numbers)

    def send_numbers(self, topic: str, time_ns: Times, numbers: Numbers) -> None:
        """Draw the curves, or poses, of one topic: log times (N,) in ns, and values (N,) of each of its
        `number_fields`."""
        for curve, curve_ns, values in curve_values(topic, time_ns, numbers):
            self.curve(curve, curve_ns, values)
        if topic == VEHICLE:
            self._count(numbers["steering"])
        elif topic == PILOT_COMMAND:
            self._drivers(time_ns, numbers["driver"].astype(np.int64))
        elif topic == POSE:
            self._poses(time_ns, np.stack([numbers[name] for name in _POSE_FIELDS]))

    def send_arcs(self, topic: str, time_ns: Times, numbers: Numbers) -> None:
        """Draw the steering of one topic over the frame, from the same numbers: much larger than curves."""
        for curve, curve_ns, values in curve_values(topic, time_ns, numbers):
            if curve.entity in ARCS:
                self.arcs(curve, curve_ns, values)

    def curve(self, curve: Curve, time_ns: Times, values: Values) -> None:
        """Draw a curve, which need not come from the log: log times (N,) in ns, values (N,)."""
        entity = self._prefix + curve.entity
        if self._is_new(entity):
            name, color = curve.name, curve.color
            if self._color is not None and curve.entity == DRIVEN_SPEED:
                name, color = self._name, self._color
            style = rr.SeriesLines(names=name, colors=[color], widths=1.5)
            self._recording.log(entity, style, static=True)
        self._send(entity, time_ns, rr.Scalars.columns(scalars=values))

    def arcs(self, curve: Curve, time_ns: Times, values: Values) -> None:
        """Draw steering as arcs over the frame: log times (N,) in ns, steering (N,), -1..1."""
        entity = self._prefix + CENTER + curve.entity
        if self._is_new(entity):
            width = ARCS.get(curve.entity, 1.5)
            style = rr.LineStrips2D.from_fields(colors=[curve.color], radii=[-width], draw_order=60 - width)
            self._recording.log(entity, style, static=True)
        self._send(entity, time_ns, rr.LineStrips2D.columns(strips=strips(arcs(values, self.picture_size))))

    def finish(self) -> None:
        """Draw histogram and path of all messages until now. They are shown at all times."""
        if not self._has_new:
            return
        self._has_new = False
        if self._counts.any():
            self._recording.log(self._prefix + HISTOGRAM, histogram(self._counts), static=True)
        if self._trail.points:
            strip = np.array(self._trail.points, np.float32)
            way = rr.LineStrips2D([strip], colors=[self._color or _PATH_COLOR], radii=[-1.5])
            self._recording.log(self._prefix + PATH, way, static=True)

    def _count(self, steering: Values) -> None:
        in_range = np.clip(steering[np.isfinite(steering)], -1.0, 1.0)
        self._counts += np.bincount(bin_of(in_range, BINS), minlength=BINS)
        self._has_new = True

    def _drivers(self, time_ns: Times, drivers: Times) -> None:
        """Send the driver at each change."""
        before = np.concatenate([[-1 if self._driver is None else self._driver], drivers[:-1]])
        changes = np.flatnonzero(drivers != before)
        entity = self._prefix + DRIVER
        if self._is_new(entity):
            names, colors = zip(*DRIVERS.values(), strict=True)
            self._recording.log(entity, rr.StateConfiguration(values=names, colors=colors), static=True)
        if len(changes):
            states = [DRIVERS.get(drivers[at], DRIVERS[0])[0] for at in changes]
            self._send(entity, time_ns[changes], rr.StateChange.columns(state=states))
        self._driver = int(drivers[-1]) if len(drivers) else self._driver

    def _poses(self, time_ns: Times, poses: Values) -> None:
        x, y, z, qx, qy, qz, qw = poses
        heading = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy**2 + qz**2))  # radians from x towards y
        placed = np.stack([x, y, heading], axis=1)
        is_known = np.isfinite(placed).all(axis=1) & (np.abs(placed) < 1e6).all(axis=1)
        placed = placed[is_known]
        points = placed[:, :2] * (1, -1)  # in a picture, y points down
        self._trail.add(points)
        entity = self._prefix + CAR
        if self._is_new(entity):
            style = rr.Arrows2D.from_fields(colors=[(255, 255, 255)], radii=[-3.0], draw_order=50.0)
            self._recording.log(entity, style, static=True)
        ahead = _CAR_M * np.stack([np.cos(placed[:, 2]), -np.sin(placed[:, 2])], axis=1)
        self._send(entity, time_ns[is_known], rr.Arrows2D.columns(origins=points, vectors=ahead))
        in_space = rr.InstancePoses3D.columns(
            translations=np.stack([x, y, z], axis=1)[is_known],
            quaternions=np.stack([qx, qy, qz, qw], axis=1)[is_known],
        )
        self._send(self._prefix + POSE, time_ns[is_known], in_space)
        self._has_new = True

    def _events(self, time_ns: Times, events: Sequence[Any]) -> None:
        levels = [_LEVELS.get(event.level, "INFO") for event in events]
        columns = rr.TextLog.columns(text=[event.message for event in events], level=levels)
        self._send(self._prefix + EVENTS, time_ns, columns)

    def _is_new(self, entity: str) -> bool:
        is_new = entity not in self._styled
        self._styled.add(entity)
        return is_new

    def _send(self, entity: str, time_ns: Times, columns: Any) -> None:
        if len(time_ns):
            self._recording.send_columns(entity, self.clock(time_ns), columns)


class Trail:
    """The points of a driven path, thinned out to at most `MAX_PATH_POINTS`."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        self._apart_m = 1.0

    def add(self, points: NDArray[np.float64]) -> None:
        """Add points (N, 2) in m, in the order in which they were driven."""
        for x, y in points.tolist():
            if not self.points or math.dist(self.points[-1], (x, y)) >= self._apart_m:
                self.points.append((x, y))
            if len(self.points) > MAX_PATH_POINTS:
                self.points = self.points[::2]
                self._apart_m *= 2


def number_fields(topic: str) -> list[str]:
    """The fields of a topic's messages that are drawn as numbers; empty for a topic with other drawings."""
    others = {PILOT_COMMAND: ("driver",), POSE: _POSE_FIELDS}.get(topic, ())
    return list(dict.fromkeys((*(line.field for line in TOPICS[topic].lines), *others)))


def curve_values(topic: str, time_ns: Times, numbers: Numbers) -> Iterator[tuple[Curve, Times, Values]]:
    """The curves of N messages of `topic`, each with log times and values. For optional fields, messages without
    the field are left out."""
    for line in TOPICS[topic].lines:
        curve, values = Curve(line.path, line.label, COLORS[line.color]), numbers[line.field]
        if not line.is_optional:
            yield curve, time_ns, values
            continue
        is_known = ~np.isnan(values)
        if is_known.any():
            yield curve, time_ns[is_known], values[is_known]


def prediction_curves(predictions: LogPredictions, first: int = 0) -> Iterator[tuple[Curve, Times, Values]]:
    """The curves of the predicted steering of each run and, where steering was recorded, of its error: curve, log
    times (N,) in ns, values (N,). `first` is the number of the first run, which determines its colour."""
    is_recorded = np.isfinite(predictions.recorded)
    for number, (run, steering) in enumerate(predictions.predicted.items(), first):
        color, part = _RUN_COLORS[number % len(_RUN_COLORS)], rr.escape_entity_path_part(run)
        yield Curve(f"{STEERING.path}/predicted_by/{part}", run, color), predictions.log_time_ns, steering
        if is_recorded.any():
            yield (
                Curve(f"{ERRORS}/{part}", run, color),
                predictions.log_time_ns[is_recorded],
                predictions.unit.per_deg * predictions.error_deg(run)[is_recorded],
            )


def numbers_of(topic: str, contents: Sequence[Any]) -> Numbers:
    """The fields `number_fields` of N messages; NaN where a message lacks an optional field."""
    optional = {line.field for line in TOPICS[topic].lines if line.is_optional}

    def values(field: str) -> Iterator[float]:
        value = operator.attrgetter(field)
        for content in contents:
            yield math.nan if field in optional and not content.HasField(field) else value(content)

    return {name: np.fromiter(values(name), np.float64, len(contents)) for name in number_fields(topic)}


def arcs(steering: Values, size: tuple[int, int]) -> NDArray[np.float32]:
    """Arcs that show steering (N,) over a picture of `size` (width, height): N times nine points x, y in pixels.
    An arc begins at the middle of the bottom and ends half a picture higher. At full lock, it ends almost half a
    picture to the side. It is not the car's path."""
    width, height = size
    bend = np.clip(np.nan_to_num(steering), -1.0, 1.0)[:, None] * (_ALONG**2)
    x = width * (0.5 + 0.45 * bend)
    y = np.broadcast_to(height * (0.95 - 0.5 * _ALONG), x.shape)
    return np.stack([x, y], axis=2).astype(np.float32)


def strips(points: NDArray[np.float32]) -> pa.Array:
    """N lines of M points (N, M, 2) in Rerun's storage format; Rerun itself would convert them one by one."""
    inner = pa.FixedSizeListArray.from_arrays(pa.array(points.reshape(-1)), type=_STRIPS.value_type)
    offsets = np.arange(0, len(points) * points.shape[1] + 1, points.shape[1], dtype=np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), inner, type=_STRIPS)


def frame_size(picture: bytes) -> tuple[int, int] | None:
    """Width and height of a JPEG or PNG; None for another format, or if the picture is too large to show."""
    return None if decoding_problem(picture) else width_and_height(picture)


def histogram(counts: NDArray[np.int64]) -> rr.BarChart:
    bins = len(counts)
    middles = (np.arange(bins) + 0.5) * 2 / bins - 1
    widths = np.full(bins, 0.9 * 2 / bins, np.float32)
    return rr.BarChart(counts, abscissa=middles, widths=widths, color=BLUE)
