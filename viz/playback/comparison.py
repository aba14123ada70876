"""Several logs side by side on one time line: by time since each log's start, or by place along the track."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import Chunk

from common import Skipped, UserError
from recorder import Log
from viz.playback.blueprint import LOG_COLORS, comparison_layout, log_entity
from viz.playback.curves import Drawing
from viz.playback.log_chunks import read_chunks
from viz.playback.rerun_recording import (
    DrawnMessages,
    PreparedRecording,
    check_moment,
    draw,
    drawn_topics,
    open_whole_log,
    predicted_curves,
    send_chunks,
    topics_with_messages,
)
from viz.timelines import SINCE_START, Clock, Times, start_clock

By = Literal["time", "place"]

PLACE: Final = "place_cm"
"""Centimetres along the path of the first log. Rerun's time lines without time units need whole numbers."""

MAX_LOGS: Final = 6
_LEFT_OUT: Final = "CoordinateFrame:frame"  # it names a picture's entity without the prefix of its log
Path2D = NDArray[np.float64]

FAR_M: Final = 10.0  # a path with a larger median distance is on another road

_AHEAD_M: Final = 40.0  # range of the search for the next place: a road may come near itself farther ahead


@dataclass(frozen=True)
class _ComparedLog:
    name: str
    log: Log
    drawn: DrawnMessages
    clock: Clock


def check_count(paths: Sequence[Path]) -> None:
    if len(paths) > MAX_LOGS:
        raise UserError(f"{len(paths)} logs: at most {MAX_LOGS} can be shown next to each other")


@contextlib.contextmanager
def prepare_comparison(
    paths: Sequence[Path], by: By = "time", at_s: float | None = None
) -> Iterator[PreparedRecording]:
    """Prepare the logs at `paths` side by side. By time, the recording opens `at_s` seconds after their starts.

    Raises LogError if a log cannot be read; UserError for too many logs, or if they cannot be compared by place.
    """
    check_count(paths)
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(open_whole_log(path)) for path in paths]
        check_moment(at_s, zip(paths, (log for log, _ in opened), strict=True))
        drawn = [DrawnMessages(log) for log, _ in opened]
        by_time = [start_clock(log.time_range_ns[0]) for log, _ in opened]
        clocks = _by_place(paths, drawn) if by == "place" else by_time
        logs = [
            _ComparedLog(name, log, messages, clock)
            for name, (log, _), messages, clock in zip(names_of(paths), opened, drawn, clocks, strict=True)
        ]
        topics = {compared.name: topics_with_messages(compared.log) for compared in logs}
        layout = comparison_layout(topics, PLACE if by == "place" else SINCE_START, at_s=at_s)
        notices = [notice for _, notice in opened if notice]
        name = " | ".join(topics)
        skipped = Skipped()
        yield PreparedRecording(
            name,
            layout,
            lambda recording, flush, every: _send(logs, recording, flush, skipped, every),
            notices,
            at_s=at_s,
            skipped=skipped,
        )


def names_of(paths: Sequence[Path]) -> list[str]:
    """A name for each log: its file's name; for equal names its path."""
    stems = [path.name.removesuffix(".mcap") for path in paths]
    return [
        stem if stems.count(stem) == 1 else str(path).removesuffix(".mcap")
        for path, stem in zip(paths, stems, strict=True)
    ]


def _by_place(paths: Sequence[Path], drawn: Sequence[DrawnMessages]) -> list[Clock]:
    """Clocks by place along the first log's path. Raises UserError for a log without poses, or of another
    track."""
    ways = [_way(path, messages) for path, messages in zip(paths, drawn, strict=True)]
    first = ways[0][1]
    clocks = []
    for path, (time_ns, way) in zip(paths, ways, strict=True):
        placed_m = distances_along(first, way)
        if placed_m is None:
            raise UserError(f"{path}: not on the road of {paths[0]}: compare them by time, without --by place")
        clocks.append(_place_clock(time_ns, placed_m))
    return clocks


def _place_clock(pose_ns: Times, placed_m: NDArray[np.float64]) -> Clock:
    def columns(time_ns: Times) -> list[rr.TimeColumn]:
        place_m = np.interp((time_ns - pose_ns[0]) * 1e-9, (pose_ns - pose_ns[0]) * 1e-9, placed_m)
        return [rr.TimeColumn(PLACE, sequence=np.round(100 * place_m).astype(np.int64))]

    return columns


def _way(path: Path, drawn: DrawnMessages) -> tuple[Times, NDArray[np.float64]]:
    time_ns, poses = drawn.poses
    way = np.stack([poses["pose.position.x"], poses["pose.position.y"]], axis=1)
    is_known = np.isfinite(way).all(axis=1)
    order = np.argsort(time_ns[is_known], kind="stable")
    if not is_known.any():
        raise UserError(f"{path}: has no poses, so it has no place: compare by time, without --by place")
    return time_ns[is_known][order], way[is_known][order]


def _send(
    logs: Sequence[_ComparedLog],
    recording: rr.RecordingStream,
    flush: Callable[[], object],
    skipped: Skipped,
    every: int,
) -> None:
    for number, compared in enumerate(logs):
        color = LOG_COLORS[number % len(LOG_COLORS)]
        drawing = Drawing(recording, compared.clock, log_entity(compared.name), compared.name, color)
        draw(compared.drawn, drawing)
        for curve, time_ns, values in predicted_curves(compared.log):
            drawing.curve(curve, time_ns, values)
    for compared in logs:
        send_chunks(_moved(compared, skipped, every), recording, flush)


def _moved(compared: _ComparedLog, skipped: Skipped, every: int) -> Generator[Chunk]:
    """The chunks of topics that are not drawn, under the log's entity and on the common time line."""
    all_chunks = read_chunks(compared.log, drawn_topics(compared.log), compared.clock, skipped, _LEFT_OUT, every)
    with contextlib.closing(all_chunks) as chunks:
        for chunk in chunks:
            if not chunk.is_static:
                yield chunk.with_entity_path(log_entity(compared.name) + chunk.entity_path)


def distances_along(path: Path2D, other: Path2D) -> NDArray[np.float64] | None:
    """Distances (M,) in m along `path` (N, 2) of the points of `other` (M, 2): each at the nearest point of `path`
    that is not behind the point before. None if `other` is on another road.

    Beyond the end of `path`, distances are along `other`, which may leave the road.
    """
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])  # m, to each point
    start, off_m = _first(path, lengths, other[0])
    steps_m = np.concatenate([[0.0], np.hypot(*np.diff(other, axis=0).T)])
    placed = np.empty(len(other))
    offs_m = [off_m]
    at, beyond_m = start, 0.0
    for number, (point, step_m) in enumerate(zip(other, steps_m, strict=True)):
        if at == len(path) - 1:
            beyond_m += step_m if number else 0.0
        else:
            end = int(np.searchsorted(lengths, lengths[at] + _AHEAD_M, "right"))
            distances = np.hypot(*(path[at:end] - point).T)
            at += int(np.argmin(distances))
            offs_m.append(float(distances.min()))
        placed[number] = lengths[at] + beyond_m
    return placed if np.median(offs_m) <= FAR_M else None


def _first(path: Path2D, lengths: NDArray[np.float64], point: Path2D) -> tuple[int, float]:
    """The number and the distance of the nearest point of `path`, in its first part near `point`: a lap ends where
    it began."""
    distances = np.hypot(*(path - point).T)
    near = distances <= 1.5 * distances.min() + 2.0
    begin = int(np.argmax(near))
    end = int(np.searchsorted(lengths, lengths[begin] + 2 * _AHEAD_M, "right"))
    at = begin + int(np.argmin(distances[begin:end]))
    return at, float(distances[at])
