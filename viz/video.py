"""A log as a video: the centre camera's pictures with their timing, as H.264 in an .mp4 that plays everywhere."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from common import Skipped, UserError, atomic_file
from common.errors import counted
from common.files import refuse_existing, write_remedy
from common.progress import track
from dataset.preprocessing import decode
from recorder import Log, LogError
from recorder.bc_pb2 import PilotCommand
from recorder.log.session_car import known_max_steering_deg
from recorder.rows.row_quality import GAP_S
from recorder.topics import DRIVE_METADATA, PILOT_COMMAND, VEHICLE, camera_topic
from viz.video_overlay import Driver, Image, Panel, Reading

if TYPE_CHECKING:
    from av import VideoFrame

_DRIVERS: Final[dict[float, Driver]] = {
    PilotCommand.PILOT: "network",
    PilotCommand.HUMAN: "human",
    PilotCommand.EXPERT: "expert",
}
_MIN_TOP_MPH, _MAX_TOP_MPH = 30.0, 300.0  # the simulator's car reaches 30


class Readings:
    def __init__(self, log: Log) -> None:
        """Raises LogError if the log is damaged."""
        self._begin_ns = log.time_range_ns[0]
        self._states = _Rows(log, VEHICLE, "steering", "throttle", "brake", "speed_mph")
        self._commands = _Rows(log, PILOT_COMMAND, "predicted_steering", "set_speed_mph", "driver")
        self.max_steering_deg = known_max_steering_deg(log)
        """The wheels' angle at steering 1; None: unknown."""
        # the driver of a session of the built-in simulator; in a drive, each command names the driver
        self._driver: Driver | None = "expert" if log.metadata.get("driver") == "expert" else None
        self._autonomy_percent = _percent(log.read_metadata(DRIVE_METADATA).get("autonomy_percent", ""))

    @property
    def top_mph(self) -> float:
        """The end of the speed bar."""
        top = max(_MIN_TOP_MPH, min(self._states.largest(3), _MAX_TOP_MPH))
        return 10.0 * math.ceil(top / 10)

    def at(self, time_ns: int) -> Reading:
        """The readings at a log time: the last values until then, at most a second old."""
        steering, throttle, brake, speed_mph = self._states.at(time_ns)
        predicted, set_speed_mph, driver = self._commands.at(time_ns)
        return Reading(
            time_s=max(0, time_ns - self._begin_ns) / 1e9,
            steering=steering,
            predicted_steering=predicted,
            throttle=throttle,
            brake=brake,
            speed_mph=speed_mph,
            set_speed_mph=set_speed_mph,
            driver=self._driver if math.isnan(driver) else _DRIVERS.get(driver),
            autonomy_percent=self._autonomy_percent,
        )


class _Rows:
    def __init__(self, log: Log, topic: str, *fields: str) -> None:
        table = log.numbers(topic, fields)
        times_ns = table["log_time_ns"].to_numpy()
        order = np.argsort(times_ns, kind="stable")
        self._times_ns = times_ns[order]
        self._values = np.stack([table[name].to_numpy() for name in fields], axis=1)[order]

    def at(self, time_ns: int) -> list[float]:
        """The last values at `time_ns` or up to `GAP_S` before it; NaN without them."""
        place = int(np.searchsorted(self._times_ns, time_ns, "right")) - 1
        if place < 0 or time_ns - int(self._times_ns[place]) > GAP_S * 1e9:
            return [math.nan] * self._values.shape[1]
        row: list[float] = self._values[place].tolist()
        return row

    def largest(self, column: int) -> float:
        """The largest finite number of a column, but at least 0."""
        numbers = self._values[:, column]
        return float(np.max(numbers[np.isfinite(numbers)], initial=0.0))


def _percent(text: str) -> float:
    """A percentage in a log's metadata; NaN if the text is not a percentage."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if 0 <= value <= 100 else math.nan


TICKS_A_SECOND: Final = 60
"""Times of pictures are rounded to a sixtieth of a second, which is enough for every screen and player."""
HELD_S: Final = 0.5  # seconds for which the last picture before a gap stays, instead of the gap
MIN_SPEED, MAX_SPEED = 0.01, 1000.0

_MIN_WIDTH, _MAX_SIDE, _MIN_SIDE = 640, 1920, 64
_TICK: Final = Fraction(1, TICKS_A_SECOND)
# g: a key frame every few seconds, for seeking; bf: with B-frames, the last picture would lose its duration
_ENCODER: Final = {"preset": "veryfast", "crf": "23", "g": "60", "bf": "0"}
_BT601: Final = 6  # SMPTE 170M, which OpenCV converts to


@dataclass(frozen=True)
class Video:
    """A written video, and the parts of its log that are not in it."""

    pictures: int
    duration_s: float
    width: int
    height: int
    left_out: int  # pictures left out because another one has the same sixtieth of a second
    gaps: int  # gaps of more than a second, each shortened to `HELD_S`
    cut_s: float  # seconds of the log that the shortened gaps leave out
    skipped: Skipped  # pictures that are damaged or do not decode: the picture before is shown instead
    notice: str  # a notice that the log was never finished; empty for a finished log


@dataclass(frozen=True)
class Schedule:
    numbers: NDArray[np.int64]
    ticks: NDArray[np.int64]  # at which each picture appears
    end: int  # tick at which the last picture ends
    gaps: int
    cut_s: float

    def shown(self) -> Iterator[tuple[int, int, int]]:
        """The number, the begin and the end of each picture."""
        ends = np.append(self.ticks[1:], self.end)
        return zip(self.numbers.tolist(), self.ticks.tolist(), ends.tolist(), strict=True)


def check_speed(speed: float) -> None:
    if not MIN_SPEED <= speed <= MAX_SPEED:
        raise UserError(f"--speed {speed:g}: expected a number from {MIN_SPEED:g} to {MAX_SPEED:g}")


def write_video(
    path: Path, video: Path, *, speed: float = 1.0, overlay: bool = False, overwrite: bool = False
) -> Video:
    """Write the log at `path` as `video`, an .mp4 that plays `speed` times as fast as the drive.

    `overlay` draws instruments below the pictures. An unfinished log is shown up to its last complete chunk.
    Raises LogError if the log cannot be read. Raises UserError if the log has no picture of the
    centre camera, if `video` exists and may not be overwritten, or if the disk is full.
    """
    check_speed(speed)
    refuse_existing(video, overwrite)
    with Log(path, shows_progress=True) as log:
        pictures = _Pictures(log)
        plan = schedule(pictures.times_ns, speed)
        readings = Readings(log) if overlay else None
        panel = (
            Panel(pictures.width, readings.top_mph, readings.max_steering_deg) if readings is not None else None
        )
        height = pictures.height + (panel.height if panel is not None else 0)
        canvas = np.zeros((height, pictures.width, 3), np.uint8)
        with atomic_file(video, overwrite=overwrite) as part, _Mp4(part, video, pictures.width, height) as mp4:
            for number, begin, end in track(plan.shown(), "video", len(plan.numbers)):
                pictures.draw(number, canvas[: pictures.height])
                if readings is not None and panel is not None:
                    canvas[pictures.height :] = panel.draw(readings.at(int(pictures.times_ns[number])))
                mp4.add(canvas, begin, end)
        return Video(
            pictures=len(plan.numbers),
            duration_s=plan.end / TICKS_A_SECOND,
            width=pictures.width,
            height=height,
            left_out=len(pictures.times_ns) - len(plan.numbers),
            gaps=plan.gaps,
            cut_s=plan.cut_s,
            skipped=pictures.skipped,
            notice=log.notice,
        )


def schedule(times_ns: NDArray[np.int64], speed: float) -> Schedule:
    """The schedule of pictures with log times (N,), N > 0, in a video that plays `speed` times as fast."""
    step_s = np.diff(times_ns) / 1e9
    is_gap = (step_s > GAP_S) | (step_s < 0)
    at_s = np.concatenate([[0.0], np.cumsum(np.where(is_gap, HELD_S, step_s))]) / speed
    ticks, numbers = np.unique(np.rint(at_s * TICKS_A_SECOND).astype(np.int64), return_index=True)
    usual = int(np.median(np.diff(ticks))) if len(ticks) > 1 else TICKS_A_SECOND
    return Schedule(
        numbers=numbers,
        ticks=ticks,
        end=int(ticks[-1]) + usual,
        gaps=int(is_gap.sum()),
        cut_s=float((step_s - HELD_S)[is_gap & (step_s > 0)].sum()),
    )


class _Pictures:
    """The pictures of the centre camera, resized to the size of the video."""

    def __init__(self, log: Log) -> None:
        """Raises UserError if no picture decodes."""
        self.skipped = Skipped()
        self._log = log
        self._index = log.pictures(camera_topic("center"))
        self.times_ns = self._index.log_time_ns
        sound = (picture for i in range(len(self.times_ns)) if (picture := self._decoded(i)) is not None)
        first = next(sound, None)
        if first is None:
            many = f"none of {counted(len(self.times_ns), 'picture')}" if len(self.times_ns) else "no picture"
            raise UserError(f"{log.path}: {many} of the centre camera can be shown, and a video needs them")
        self.width, self.height = _video_size(first.shape[1], first.shape[0])
        if min(self.width, self.height) < _MIN_SIDE:
            size = f"{first.shape[1]} x {first.shape[0]}"
            raise UserError(f"{log.path}: pictures of {size} pixels cannot become a video")

    def draw(self, number: int, canvas: Image) -> None:
        """Draw a picture on `canvas` (height, width, 3) BGR. A broken picture is counted, and `canvas` stays."""
        picture = self._decoded(number)
        if picture is None:
            row = int(self._index.sequence[number])
            self.skipped.add("broken pictures, shown as the one before", f"row {row}")
            return
        is_larger = picture.shape[1] > self.width
        cv2.resize(
            picture,
            (self.width, self.height),
            dst=canvas,
            interpolation=cv2.INTER_AREA if is_larger else cv2.INTER_CUBIC,
        )

    def _decoded(self, number: int) -> Image | None:
        index = self._index
        place = int(index.offset[number]), int(index.length[number]), int(index.chunk[number])
        try:
            return decode(self._log.read(*place))
        except (LogError, ValueError):  # its chunk is damaged, or it is not a picture
            return None


class _Mp4:
    """A video that is being written to the temporary file `part`. Messages name it `name`."""

    def __init__(self, part: Path, name: Path, width: int, height: int) -> None:
        import av  # slow

        self._name = name
        self._new_frame: Any = av.VideoFrame.from_ndarray
        self._error: Any = av.FFmpegError
        with self._refused():
            # faststart: the index comes first, so that a browser can play before it has the whole file
            # FFmpeg takes what is before a colon in a name for a protocol
            self._container = av.open(f"file:{part}", "w", format="mp4", options={"movflags": "+faststart"})
        self._stream = self._container.add_stream("libx264", rate=TICKS_A_SECOND, options=_ENCODER)
        self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
        self._stream.codec_context.time_base = _TICK
        self._stream.codec_context.colorspace = _BT601
        self._ends: dict[int, int] = {}

    def add(self, picture: Image, begin: int, end: int) -> None:
        """Add a picture (height, width, 3) BGR, shown from tick `begin` to `end`."""
        # the conversion of the encoder's library rounds down: grey would become dark green
        frame = self._new_frame(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420), format="yuv420p")
        frame.pts, frame.time_base = begin, _TICK
        self._ends[begin] = end
        self._encode(frame)

    def _encode(self, frame: VideoFrame | None) -> None:
        for packet in self._stream.encode(frame):
            if packet.pts is not None:  # always for pictures
                packet.duration = self._ends.pop(packet.pts) - packet.pts
            with self._refused():
                self._container.mux(packet)

    @contextlib.contextmanager
    def _refused(self) -> Iterator[None]:
        try:
            yield
        except self._error as error:
            raise UserError(
                f"{self._name}: cannot be written ({error.strerror}); nothing of it was kept:"
                f" {write_remedy(error)}, and try again"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            with contextlib.suppress(self._error):
                self._container.close()
            return
        self._encode(None)
        with self._refused():
            self._container.close()


def _video_size(width: int, height: int) -> tuple[int, int]:
    """The size of a video for pictures of this size: enlarged by a whole number, at most _MAX_SIDE, and even, as
    H.264 needs."""
    scale = float(max(1, math.ceil(_MIN_WIDTH / width)))
    scale = min(scale, _MAX_SIDE / max(width, height))
    return int(width * scale) // 2 * 2, int(height * scale) // 2 * 2
