"""Cleans the rows of any recording: every tolerance and every question of an import stands here.

Rows go through these functions in their order: times, commands, cameras, steering, order. Then each row's pictures
are read and checked. What cannot be used is counted by its reason; what only the user can know is asked.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common import Skipped
from common.car import Camera
from common.errors import counted
from common.untrusted import read_bounded
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError
from recorder.log.meant_gaps import MeantGap
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.pictures.picture_size import is_whole_picture
from recorder.rows.row_quality import GAP_S
from recorder.sources.imported_rows import (
    FROM_1970,
    ImportedRow,
    Picture,
    RawRecording,
    RecordedRow,
    SkippedEvents,
    UnreadablePictureError,
)
from recorder.sources.picture_folder import WITHOUT_ROW
from recorder.sources.settings import ImportSettings, TimeUnit, check_rate, describe_clock

MAX_PICTURE_BYTES: Final = 1 << 26
APART_NS: Final = 10_000_000_000
"""Between episodes whose times begin anew, so that each is a drive."""
NOT_WHOLE: Final = "pictures that are not whole JPEG or PNG files"
UNREADABLE: Final = "pictures that cannot be read"
REPEATED_ROWS: Final = "rows with the pictures of an earlier row"
REPEATED: Final = "pictures that an earlier row names, too"
WITHOUT_STEERING: Final = "whose steering is not a finite number"
OUT_OF_RANGE: Final = "rows with steering beyond -1..1 (kept, but an index leaves them out)"
NO_LOG_HOLDS: Final = "with a time that no log can hold"

NS: Final[dict[TimeUnit, int]] = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
UNIT_NAMES: Final[dict[TimeUnit, str]] = {
    "s": "seconds",
    "ms": "milliseconds",
    "us": "microseconds",
    "ns": "nanoseconds",
}
_MIN_STEP_NS: Final = 5e6  # more than 200 pictures a second are less likely than a wrong unit
_MAX_BACK: Final = 0.1  # share of the rows; recordings of several drives go back a few times
_FEW_DRIVES: Final = 2
_LATE_NS: Final = 1_000_000_000  # a row that goes back by less was written late; by more, another drive begins
_PEAK: Final = 0.1  # share of the rows at the most frequent steering, if it is straight on
_FEW_ROWS: Final = 10  # too few to ask about
_SIDE_WORDS: Final[dict[Camera, tuple[str, ...]]] = {
    "left": ("left",),
    "right": ("right",),
    "center": ("center", "centre", "front", "middle", "mid"),
}


@dataclass
class CleanRecording:
    """A recording that can be written: times in nanoseconds, steering of -1..1, rows in order."""

    recording: RawRecording
    rows: list[RecordedRow]
    times_ns: list[int]
    metadata: dict[str, str]
    questions: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)

    def summary(self) -> str:
        """What was recognised: "600 rows, 10.0 a second, steering -0.50 to 0.45, most often 0.00"."""
        usable = [(time, row) for time, row in zip(self.times_ns, self.rows, strict=True) if not row.problem]
        parts = [counted(len(usable), "row")]
        steps = _steps_ns([time for time, _ in usable])
        if len(steps):
            parts.append(f"{1e9 / float(np.median(steps)):.3g} a second")
        steering = np.array([row.steering for _, row in usable if row.steering is not None])
        if len(steering):
            low, high = _short(steering.min()), _short(steering.max())
            parts.append(f"steering {low} to {high}, most often {_short(most_frequent(steering))}")
        return ", ".join(parts)


def camera_named(text: str) -> Camera | None:
    """The camera that a text names: left_camera, CENTER, front. None for others."""
    low = text.lower()
    found = [camera for camera, words in _SIDE_WORDS.items() if any(word in low for word in words)]
    return found[0] if len(found) == 1 else None


def clean(recording: RawRecording, settings: ImportSettings) -> CleanRecording:
    """Clean all but the pictures. Raises RecordingError for flags that do not fit the recording."""
    scale = settings.steering_scale
    rows = list(recording.rows)
    unit = settings.time_unit or recording.time_unit
    times_ns, metadata = _times(recording, rows, settings, unit)
    if scale != 1:
        metadata["steering_scale"] = repr(scale)
    if settings.steering_offset:
        metadata["steering_offset"] = repr(settings.steering_offset)
    if recording.commands is not None:
        _join_commands(recording.commands, rows, times_ns, settings, unit)
    rows, times_ns = _merge_cameras(rows, times_ns)
    cleaned = CleanRecording(recording, rows, times_ns, metadata, notices=list(recording.notices))
    raw = np.array([row.steering for row in rows if not row.problem and row.steering is not None])
    raw = raw[np.isfinite(raw)]
    cleaned.questions += filter(
        None, (_unit_question(recording, cleaned, settings, unit), _steering_question(raw, settings))
    )
    if recording.camera_column:
        cleaned.questions.append(
            f"column {recording.camera_column!r} names a camera for each row, and all became the centre camera:"
            f" add camera={recording.camera_column} to --columns?"
        )
    for row in rows:
        if row.problem or row.steering is None:
            continue
        if not math.isfinite(row.steering):
            row.problem = f"{recording.noun} {WITHOUT_STEERING}"
        else:
            row.steering = (row.steering + settings.steering_offset) * scale
    _refuse_repeated(rows)
    _order(cleaned)
    return cleaned


def rows_to_write(cleaned: CleanRecording, events: SkippedEvents) -> Iterator[ImportedRow]:
    """The rows with their pictures, in order. Rows and pictures that cannot be used are skipped as they come.

    Raises RecordingError if no row can be used, or no picture is there.
    """
    recording, skipped = cleaned.recording, events.skipped
    if all(row.problem for row in cleaned.rows):
        for row in cleaned.rows:
            skipped.add(row.problem, row.name)
        hint = recording.hint if len(skipped) else ""
        raise RecordingError(f"{recording.without_rows}{skipped.error_suffix()}{hint}")
    named = set[str]()  # paths of pictures
    last_episode: int | None = None
    pictures = 0
    for row, time_ns in zip(cleaned.rows, cleaned.times_ns, strict=True):
        if row.problem:
            skipped.add(row.problem, row.name)
            named.update(path for name in names_of(row) if (path := _path(recording, name)))
            continue
        events.time_ns = time_ns
        sound = {
            camera: content
            for camera, picture in row.pictures.items()
            if (content := _content(recording, picture, row, named, skipped)) is not None
        }
        if not sound and not recording.keeps_rows_without_pictures:
            if not row.pictures:
                skipped.add(f"{recording.noun} without a picture", row.name)
            continue
        steering = row.steering if row.steering is not None else math.nan
        if abs(steering) > 1:
            skipped.add(OUT_OF_RANGE, f"{row.name}: {steering:g}")
        gap = row.gap
        if row.episode is not None and gap is None and last_episode not in (None, row.episode):
            gap = MeantGap(APART_NS / 1e9, "another episode begins")
        pictures += len(sound)
        yield ImportedRow(time_ns, state_of(row, recording.mph), list(sound.items()), gap)
        last_episode = row.episode
    if recording.folder is not None:
        if not pictures and not skipped.counts[NOT_WHOLE] and not skipped.counts[UNREADABLE]:
            raise _without_pictures(recording)
        for name in filter(recording.is_picture, recording.folder.without_row(named)):
            skipped.add(WITHOUT_ROW, name)
    for reason, name in recording.missing():
        skipped.add(reason, name)


def _without_pictures(recording: RawRecording) -> RecordingError:
    why = recording.folder.why_none() if recording.folder is not None else ""
    return RecordingError(f"{recording.path}: none of its pictures is there; {why}")


def skip_unread(cleaned: CleanRecording, skipped: Skipped) -> None:
    """Skip what an import would skip without reading a picture. Raises RecordingError if no picture is there."""
    for row in cleaned.rows:
        if row.problem:
            skipped.add(row.problem, row.name)
    folder = cleaned.recording.folder
    if folder is None:
        return
    found = set[str]()
    for row in cleaned.rows:
        for name in names_of(row):
            if (path := folder.find(name)) is not None:
                found.add(path)
            elif not row.problem:
                folder.skip_missing(name, skipped)
    if not found and any(not row.problem for row in cleaned.rows):
        raise _without_pictures(cleaned.recording)
    for name in filter(cleaned.recording.is_picture, folder.without_row(found)):
        skipped.add(WITHOUT_ROW, name)


def state_of(row: RecordedRow, mph: float = 1.0) -> VehicleState:
    """The state of the car in a clean row. A throttle below 0 brakes. Pedals that are not finite become 0."""
    throttle, brake = (value if math.isfinite(value) else 0.0 for value in (row.throttle, row.brake))
    brake = max(0.0, brake, -throttle)
    steering = math.nan if row.steering is None else row.steering
    return VehicleState(steering=steering, throttle=max(0.0, throttle), brake=brake, speed_mph=row.speed * mph)


def _times(
    recording: RawRecording, rows: Sequence[RecordedRow], settings: ImportSettings, unit: TimeUnit
) -> tuple[list[int], dict[str, str]]:
    """The time of each row in nanoseconds, and the log's metadata about it."""
    check_rate(settings.rate)
    has_times = any(row.time is not None for row in rows)
    if has_times and settings.rate is not None:
        raise RecordingError(f"{recording.path}: --rate: its {recording.noun} have their times; leave it out")
    rate_hz = settings.rate or recording.rate_hz
    metadata = dict(recording.metadata)
    if not has_times:
        if rate_hz is None:
            if any(not row.problem for row in rows):
                raise RecordingError(
                    f"{recording.path}: its {recording.noun} have no times: give --rate ROWS_A_SECOND, such as 20"
                )
            return [0] * len(rows), metadata
        clock = f"{rate_hz:g} Hz, because no row has a time"
        metadata["clock"] = clock if settings.rate is None else describe_clock(rate_hz)
        if recording.start_ns is None:
            metadata |= FROM_1970
        zero_ns = recording.start_ns or 0
        # a skipped row takes time, too
        positions = [row.position if row.position is not None else at for at, row in enumerate(rows)]
        times_ns = [zero_ns + round(position * 1e9 / rate_hz) for position in positions]
        for row, time_ns in zip(rows, times_ns, strict=True):
            if not 0 <= time_ns <= LAST_TIME_NS:
                row.problem = row.problem or f"{recording.noun} {NO_LOG_HOLDS}"
        return times_ns, metadata
    if any(row.episode is not None for row in rows):
        _continue_episodes(rows, NS[unit])
        return _in_ns(recording, rows, "ns", 0), metadata
    return _in_ns(recording, rows, unit, recording.start_ns or 0), metadata


def _in_ns(recording: RawRecording, rows: Sequence[RecordedRow], unit: TimeUnit, zero_ns: int) -> list[int]:
    times_ns = []
    for row in rows:
        time_ns = 0
        if not row.problem:
            if row.time is None:
                row.problem = f"{recording.noun} without a time"
            elif (held := _held(row.time, unit, zero_ns)) is not None:
                time_ns = held
            else:
                other = next((other for other in NS if _held(row.time, other, zero_ns) is not None), None)
                hint = f" (are they {UNIT_NAMES[other]}? `--time-unit {other}`)" if other and row.time > 0 else ""
                row.problem = f"{recording.noun} {NO_LOG_HOLDS}{hint}"
        times_ns.append(time_ns)
    return times_ns


def _held(time: float, unit: TimeUnit, zero_ns: int) -> int | None:
    """The time in nanoseconds; None if no log can hold it."""
    if not 0 <= time <= LAST_TIME_NS:  # also NaN
        return None
    # whole numbers keep all digits; a float of seconds since 1970 holds microseconds
    time_ns = zero_ns + (time * NS[unit] if isinstance(time, int) else round(time * NS[unit]))
    return time_ns if time_ns <= LAST_TIME_NS else None


def _continue_episodes(rows: Sequence[RecordedRow], factor: int) -> None:
    """Give episodes, whose times begin anew, times one after the other, in nanoseconds."""
    episode: int | None = None
    start_ns = last_ns = 0
    for row in rows:
        if row.problem or row.time is None:
            continue
        if not 0 <= row.time * factor < 1e18:
            row.time = -1
            continue
        if row.episode != episode:
            start_ns = 0 if episode is None else last_ns + APART_NS
            episode = row.episode
        # in a long episode, 32-bit seconds are precise to some tens of microseconds
        row.time = start_ns + round(row.time * factor / 1000) * 1000
        last_ns = max(last_ns, row.time)


def _join_commands(
    commands: tuple[NDArray[np.int64], NDArray[np.float64]],
    rows: Sequence[RecordedRow],
    times_ns: Sequence[int],
    settings: ImportSettings,
    unit: TimeUnit,
) -> None:
    """Give each row the last steering before it, if this is not too old."""
    commands_ns, values = commands
    begins_ns = [int(time) * NS[unit] for time in commands_ns.tolist()]
    max_age_ns = settings.max_steering_age * 1e9
    for row, time_ns in zip(rows, times_ns, strict=True):
        if row.problem:
            continue
        at = bisect.bisect_right(begins_ns, time_ns) - 1
        if at < 0:
            row.problem = "pictures before the first steering"
        elif time_ns - begins_ns[at] > max_age_ns:
            row.problem = (
                f"pictures whose last steering is over {settings.max_steering_age:g} s old"
                " (--max-steering-age SECONDS allows more)"
            )
        else:
            row.steering = float(values[at])


def _merge_cameras(rows: list[RecordedRow], times_ns: list[int]) -> tuple[list[RecordedRow], list[int]]:
    """Give the pictures of side cameras, which have rows of their own, to the nearest row of the centre camera."""
    if all(row.camera is None for row in rows):
        return rows, times_ns
    centers = sorted(
        (time, at)
        for at, (row, time) in enumerate(zip(rows, times_ns, strict=True))
        if row.camera == "center" and not row.problem
    )
    steps = _steps_ns([time for time, _ in centers])
    nearest_ns = float(np.median(steps)) / 2 if len(steps) else math.inf
    kept, kept_ns = [], []
    for row, time_ns in zip(rows, times_ns, strict=True):
        side = row.camera
        if side is None or side == "center" or row.problem:
            kept.append(row)
            kept_ns.append(time_ns)
            continue
        near = bisect.bisect_left(centers, (time_ns, 0))
        candidates = [centers[at] for at in (near - 1, near) if 0 <= at < len(centers)]
        center_ns, at = min(candidates, key=lambda found: abs(found[0] - time_ns), default=(0, -1))
        if at < 0 or abs(center_ns - time_ns) > nearest_ns or side in rows[at].pictures:
            row.problem = "rows of a side camera without one of the centre camera at that time"
            kept.append(row)
            kept_ns.append(time_ns)
            continue
        (picture,) = row.pictures.values()
        rows[at].pictures = {**rows[at].pictures, side: picture}
    return kept, kept_ns


def _refuse_repeated(rows: Sequence[RecordedRow]) -> None:
    """The same pictures twice could be on both sides of a split."""
    earlier = set[tuple[str, ...]]()
    for row in rows:
        names = names_of(row)
        if names and names in earlier and not row.problem:
            row.problem = REPEATED_ROWS
        earlier.add(names)


def names_of(row: RecordedRow) -> tuple[str, ...]:
    return tuple(picture for picture in row.pictures.values() if isinstance(picture, str))


def _order(cleaned: CleanRecording) -> None:
    """Sort rows that were written out of order. Where time goes back far, another drive begins, unless this
    happens so often that the rows must be shuffled."""
    times = np.array(cleaned.times_ns, np.int64)
    usable = np.array([not row.problem for row in cleaned.rows], bool)
    places = np.flatnonzero(usable)
    steps = np.diff(times[places])
    if not (steps < 0).any():
        return
    far = steps < -_LATE_NS
    is_shuffled = far.sum() > max(_FEW_DRIVES, _MAX_BACK * len(places))
    # unusable rows stay where they are, so that they are named in order
    drives = np.zeros(len(places), np.int64)
    if not (cleaned.recording.is_by_arrival or is_shuffled):
        drives[1:] = np.cumsum(far)
    order = places[np.lexsort((times[places], drives))]
    moved = int((order != places).sum())
    rows, times_ns = list(cleaned.rows), list(cleaned.times_ns)
    for place, source in zip(places.tolist(), order.tolist(), strict=True):
        cleaned.rows[place], cleaned.times_ns[place] = rows[source], times_ns[source]
    if moved:
        back = counted(int((steps < 0).sum()), "time")
        cleaned.notices.append(f"time went back {back}, so its {cleaned.recording.noun} were sorted by time")


def _steps_ns(times_ns: Sequence[int]) -> NDArray[np.int64]:
    """The distances between times that differ."""
    ordered = np.sort(np.array(times_ns, np.int64))
    steps = ordered[1:] - ordered[:-1]
    return steps[steps > 0]


def _unit_question(
    recording: RawRecording, cleaned: CleanRecording, settings: ImportSettings, unit: TimeUnit
) -> str:
    if settings.time_unit is not None or all(row.time is None for row in cleaned.rows):
        return ""
    pairs = zip(cleaned.rows, cleaned.times_ns, strict=True)
    steps = _steps_ns([time_ns for row, time_ns in pairs if not row.problem])
    if not len(steps):
        return ""
    step_ns = float(np.median(steps))
    usual = [other for other in NS if _MIN_STEP_NS <= step_ns / NS[unit] * NS[other] <= GAP_S * 1e9]
    if not usual or unit in usual:
        return ""
    return (
        f"its {recording.noun} are {step_ns / 1e9:g} s apart: are the times {UNIT_NAMES[usual[0]]}?"
        f" `--time-unit {usual[0]}`"
    )


def _steering_question(raw: NDArray[np.float64], settings: ImportSettings) -> str:
    """Ask about a steering whose middle is not 0, or whose range is not -1..1."""
    if len(raw) < _FEW_ROWS or np.ptp(raw) == 0:
        return ""
    low, high = float(raw.min()), float(raw.max())
    offset = settings.steering_offset
    is_one_sided = (low > 0 or high < 0) and offset == 0
    is_too_large = max(abs(low + offset), abs(high + offset)) * abs(settings.steering_scale) > 1
    if not is_one_sided and not is_too_large:
        return ""
    ways = []
    if is_too_large:
        ways.append(f"{_flags(low, high, offset, settings)}, if {_short(0.0 - offset)} is straight on")
    if is_one_sided:
        usual = most_frequent(raw)
        middle = usual if np.mean(np.abs(raw - usual) <= np.ptp(raw) / 100) >= _PEAK else (low + high) / 2
        ways.append(f"{_flags(low, high, -middle, settings)}, if {_short(middle)} is")
        if not is_too_large:
            ways[-1] += " straight on"
    return f"steering lies between {_short(low)} and {_short(high)}: {'; or '.join(ways)}?"


def _flags(low: float, high: float, offset: float, settings: ImportSettings) -> str:
    """The flags with which steering lies in -1..1, and `offset` is added."""
    flags = [f"--steering-offset {_short(offset)}"] if offset else []
    largest = max(abs(low + offset), abs(high + offset))
    if largest * abs(settings.steering_scale) > 1:
        flags.append(f"--steering-scale {math.copysign(_one_digit_below(1 / largest), settings.steering_scale):g}")
    elif settings.steering_scale != 1:
        flags.append(f"--steering-scale {settings.steering_scale:g}")
    return f"`{' '.join(flags)}`"


def most_frequent(values: NDArray[np.float64]) -> float:
    """The middle of the values in the fullest of 101 equal parts of their range."""
    counts, edges = np.histogram(values, bins=101)
    at = int(counts.argmax())
    inside = values[(values >= edges[at]) & (values <= edges[at + 1])]
    return float(np.median(inside))


def _one_digit_below(value: float) -> float:
    """The largest number of one digit, or a plain fraction, that is not above `value`."""
    power = 10.0 ** math.floor(math.log10(value))
    return math.floor(value / power + 1e-9) * power


def _short(value: float) -> str:
    return f"{float(value):.3g}" if abs(value) < 1000 else f"{float(value):.0f}"


def _path(recording: RawRecording, named: str) -> str | None:
    return None if recording.folder is None else recording.folder.find(named)


def _content(
    recording: RawRecording, picture: Picture, row: RecordedRow, named: set[str], skipped: Skipped
) -> bytes | None:
    """The bytes of a picture; None if it is skipped."""
    if not isinstance(picture, str):
        name = row.name
        try:
            content = picture()
        except UnreadablePictureError as error:
            skipped.add(str(error), name)
            return None
    else:
        name = picture[-200:]
        path = _path(recording, picture)
        if path is None:
            if recording.folder is not None:
                recording.folder.skip_missing(picture, skipped)
            return None
        if path in named:  # the same picture twice could be on both sides of a split
            skipped.add(REPEATED, name)
            return None
        named.add(path)
        try:
            content = read_bounded(path, MAX_PICTURE_BYTES)
        except OSError:
            skipped.add(UNREADABLE, name)
            return None
    if len(content) > MAX_PICTURE_BYTES or not is_whole_picture(content):
        skipped.add(NOT_WHOLE, name)
        return None
    return content
