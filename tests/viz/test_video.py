"""A log as a video: read back with OpenCV's decoder, which is another than the one that wrote it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common import UserError
from recorder import Log, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS
from tests.helpers.udacity import call
from viz.cli import main
from viz.video import HELD_S, Readings, write_video
from viz.video_overlay import PREDICTED, RECORDED, WHEEL_DEG, WHEEL_RADIUS, WHEEL_X, WHEEL_Y

Image = NDArray[np.uint8]
WIDTH, HEIGHT = 320, 160  # of the simulator's pictures; in the video twice as large
PANEL = 160  # rows below them
TICK_S = 1 / 60


def grey(level: int) -> bytes:
    """A picture of one brightness, by which its frame is known again."""
    return png(np.full((HEIGHT, WIDTH, 3), level, np.uint8))


def png(picture: Image) -> bytes:
    ok, encoded = cv2.imencode(".png", picture)
    assert ok
    return encoded.tobytes()


def write_log(
    path: Path,
    pictures: Sequence[bytes],
    times_s: Sequence[float] | None = None,
    state: VehicleState | None = None,
    command: PilotCommand | None = None,
) -> Path:
    """A log of these pictures of the centre camera, a tenth of a second apart if nothing else is given."""
    with LogWriter(path, {"source": "test"}) as log:
        for row, picture in enumerate(pictures):
            time_ns = START_NS + round(1e9 * (times_s[row] if times_s is not None else row / 10))
            log.picture("center", time_ns, row, picture)
            log.vehicle(time_ns, row, state or VehicleState(steering=0.0, throttle=0.5, speed_mph=9.0))
            if command is not None:
                log.command(time_ns, row, command)
    return path


@dataclass(frozen=True)
class Decoded:
    frames: list[Image]
    times_s: list[float]
    duration_s: float


def decoded(video: Path) -> Decoded:
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    frames, times_s = [], []
    while True:
        ok, frame = capture.read()
        if not ok:
            break
        frames.append(frame.astype(np.uint8))
        times_s.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    assert len(frames) == capture.get(cv2.CAP_PROP_FRAME_COUNT)
    duration_s = len(frames) / capture.get(cv2.CAP_PROP_FPS)
    capture.release()
    return Decoded(frames, times_s, duration_s)


@dataclass(frozen=True)
class Done:
    code: int
    stdout: str
    stderr: str


@pytest.fixture
def play(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Done]:
    """`bc-play` with these arguments, and what it printed."""
    monkeypatch.setenv("NO_COLOR", "1")

    def played(*arguments: object) -> Done:
        code = call(main, *arguments)
        return Done(code, *capsys.readouterr())

    return played


def levels(frames: Sequence[Image]) -> list[float]:
    return [float(frame[:HEIGHT].mean()) for frame in frames]


# Time


def test_every_picture_appears_at_its_own_time(tmp_path: Path) -> None:
    times_s = [0.0, 0.05, 0.2, 0.25, 0.6, 0.7, 1.5, 1.55]
    shown = [20 + 25 * i for i in range(len(times_s))]
    log = write_log(tmp_path / "x.mcap", [grey(level) for level in shown], times_s)
    made = write_video(log, tmp_path / "x.mp4")
    video = decoded(tmp_path / "x.mp4")
    assert video.times_s == pytest.approx(times_s, abs=TICK_S / 2 + 1e-6)
    assert levels(video.frames) == pytest.approx(shown, abs=2)
    assert {frame.shape for frame in video.frames} == {(2 * HEIGHT, 2 * WIDTH, 3)}
    # the last one stays as long as most do: 0.1 s
    assert video.duration_s == pytest.approx(1.65, abs=TICK_S) == made.duration_s
    assert (made.pictures, made.left_out, made.gaps, len(made.skipped), made.notice) == (8, 0, 0, 0, "")


def test_it_plays_faster_and_then_leaves_out_what_no_screen_could_show(
    tmp_path: Path, play: Callable[..., Done]
) -> None:
    shown = [20 + 10 * i for i in range(20)]
    log = write_log(tmp_path / "x.mcap", [grey(level) for level in shown])
    write_video(log, tmp_path / "twice.mp4", speed=2)
    twice = decoded(tmp_path / "twice.mp4")
    assert twice.times_s == pytest.approx([i / 20 for i in range(20)], abs=1e-6)
    made = write_video(log, tmp_path / "fast.mp4", speed=12)
    fast = decoded(tmp_path / "fast.mp4")
    assert fast.times_s == pytest.approx([i / 60 for i in range(len(fast.frames))], abs=1e-6)
    assert made.pictures == len(fast.frames) < 12
    assert made.left_out == 20 - made.pictures
    done = play(log, "--video", tmp_path / "again.mp4", "--speed", 12)
    assert done.code == 0
    assert done.stderr == (
        f"{made.left_out} pictures left out, in the same sixtieth of a second as another: a video has at most"
        " 60 a second\n"
    )


def test_a_gap_is_shortened_and_said(tmp_path: Path, play: Callable[..., Done]) -> None:
    """Pushes that were not recorded, and hours between drives."""
    log = write_log(tmp_path / "x.mcap", [grey(i) for i in (50, 100, 150, 200)], [0.0, 1.0, 3.2, 7203.2])
    done = play(log, "--video", tmp_path / "x.mp4")
    video = decoded(tmp_path / "x.mp4")
    assert video.times_s == pytest.approx([0.0, 1.0, 1.0 + HELD_S, 1.0 + 2 * HELD_S], abs=1e-6)
    assert levels(video.frames) == pytest.approx([50, 100, 150, 200], abs=2)
    assert done.code == 0
    assert done.stderr == "2 gaps of more than a second shortened to 0.5 s: 2:00:01.2 of the log in all\n"
    assert done.stdout == f"{tmp_path / 'x.mp4'}: written; 4 pictures, 640 x 320, 0:02.5 long\n"


def test_where_time_goes_back_another_drive_begins(tmp_path: Path) -> None:
    log = write_log(tmp_path / "x.mcap", [grey(i) for i in (50, 100, 150, 200)], [10.0, 10.1, 2.0, 2.1])
    made = write_video(log, tmp_path / "x.mp4")
    video = decoded(tmp_path / "x.mp4")
    assert video.times_s == pytest.approx([0.0, 0.1, 0.1 + HELD_S, 0.2 + HELD_S], abs=1e-6)
    assert levels(video.frames) == pytest.approx([50, 100, 150, 200], abs=2)
    assert (made.gaps, made.cut_s) == (1, 0.0)


# The file


def test_it_is_h264_that_plays_before_all_of_it_is_there(tmp_path: Path) -> None:
    write_video(write_log(tmp_path / "x.mcap", [grey(90)] * 20), tmp_path / "x.mp4")
    data = (tmp_path / "x.mp4").read_bytes()
    assert b"avc1" in data
    assert 0 < data.index(b"moov") < data.index(b"mdat")
    configuration = data.index(b"avcC") + 4
    version, profile = data[configuration], data[configuration + 1]
    assert (version, profile) == (1, 100)  # High: 4:2:0 of 8 bits


@pytest.mark.parametrize("color", [(0, 0, 200), (0, 180, 0), (200, 0, 0), (250, 250, 250)])
def test_colours_stay_what_they_are(tmp_path: Path, color: tuple[int, int, int]) -> None:
    picture = png(np.full((HEIGHT, WIDTH, 3), color, np.uint8))
    write_video(write_log(tmp_path / "x.mcap", [picture] * 3), tmp_path / "x.mp4")
    (shown, *_) = decoded(tmp_path / "x.mp4").frames
    assert shown.mean(axis=(0, 1)) == pytest.approx(color, abs=5)


# The instruments


def angle_deg(panel: Image, color: tuple[int, int, int], low: float, high: float) -> float:
    """Where the pixels of a colour lie between two distances from the wheel's middle: degrees clockwise from its
    top."""
    places: NDArray[np.float64] = np.indices(panel.shape[:2]).astype(np.float64)
    right, up = places[1] - WHEEL_X, WHEEL_Y - places[0]
    distance = np.hypot(right, up)
    # video keeps colours of areas, and blurs their edges
    is_of_color = np.abs(panel.astype(int) - color).max(axis=2) < 60
    pixels = is_of_color & (distance > low) & (distance < high)
    assert pixels.sum() > 20
    return math.degrees(math.atan2(right[pixels].mean(), up[pixels].mean()))


@pytest.mark.parametrize(("steering", "predicted"), [(-0.6, -0.3), (0.0, 0.5), (0.35, 0.9), (1.0, -1.0)])
def test_the_wheel_turns_as_steered_and_the_pointer_as_predicted(
    tmp_path: Path, steering: float, predicted: float
) -> None:
    state = VehicleState(steering=steering, throttle=0.5, speed_mph=9.0)
    command = PilotCommand(predicted_steering=predicted, steering=predicted, driver=PilotCommand.PILOT)
    log = write_log(tmp_path / "x.mcap", [grey(90)] * 3, state=state, command=command)
    write_video(log, tmp_path / "x.mp4", overlay=True)
    panel = decoded(tmp_path / "x.mp4").frames[1][2 * HEIGHT :]
    assert panel.shape == (PANEL, 2 * WIDTH, 3)
    ring = WHEEL_RADIUS - 3, WHEEL_RADIUS + 3
    assert angle_deg(panel, RECORDED, *ring) == pytest.approx(WHEEL_DEG * steering, abs=2)
    pointer = WHEEL_RADIUS + 8, WHEEL_RADIUS + 18
    assert angle_deg(panel, PREDICTED, *pointer) == pytest.approx(WHEEL_DEG * predicted, abs=2)


def test_the_instruments_lie_below_the_picture_and_cover_nothing_of_it(tmp_path: Path) -> None:
    log = write_log(tmp_path / "x.mcap", [grey(90), grey(120)])
    write_video(log, tmp_path / "bare.mp4")
    write_video(log, tmp_path / "full.mp4", overlay=True)
    for bare, full in zip(
        decoded(tmp_path / "bare.mp4").frames, decoded(tmp_path / "full.mp4").frames, strict=True
    ):
        assert np.abs(full[: 2 * HEIGHT - 2].astype(int) - bare[:-2]).max() < 12
        assert full[2 * HEIGHT :].std() > 10


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_the_bars_are_as_long_as_the_pedals_are_down(tmp_path: Path, share: float) -> None:
    state = VehicleState(throttle=share, brake=share, speed_mph=30 * share)
    write_video(write_log(tmp_path / "x.mcap", [grey(90)] * 2, state=state), tmp_path / "x.mp4", overlay=True)
    panel = decoded(tmp_path / "x.mp4").frames[1][2 * HEIGHT :].astype(int)
    for row in (80, 104, 128):  # speed, throttle, brake
        bright = np.flatnonzero(panel[row, 260:460].max(axis=1) > 150)
        assert np.ptp(bright) == pytest.approx(168 * share + 8, abs=4)  # 8: its round ends


def test_without_network_or_states_no_pointer_and_a_straight_wheel(tmp_path: Path) -> None:
    write_video(write_log(tmp_path / "x.mcap", [grey(90)] * 2), tmp_path / "x.mp4", overlay=True)
    with pytest.raises(AssertionError):
        angle_deg(decoded(tmp_path / "x.mp4").frames[0][2 * HEIGHT :], PREDICTED, 0, 200)
    with LogWriter(tmp_path / "bare.mcap", {"source": "test"}) as log:
        log.picture("center", START_NS, 0, grey(90))
    write_video(tmp_path / "bare.mcap", tmp_path / "bare.mp4", overlay=True)
    video = decoded(tmp_path / "bare.mp4")
    with pytest.raises(AssertionError):
        angle_deg(video.frames[0][2 * HEIGHT :], RECORDED, 0, 200)
    assert video.duration_s == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("reported", "expected"), [("98.400", 98.4), ("nan", None), ("many", None), ("-3", None), ("", None)]
)
def test_who_drives_and_how_autonomously_is_what_the_log_reports(
    tmp_path: Path, reported: str, expected: float | None
) -> None:
    drivers = (PilotCommand.PILOT, PilotCommand.EXPERT, PilotCommand.HUMAN, PilotCommand.UNKNOWN)
    with LogWriter(tmp_path / "x.mcap", {"source": "drive", "driver": "pilot"}) as log:
        for row, driver in enumerate(drivers):
            log.picture("center", START_NS + row * 10**8, row, grey(90))
            log.command(START_NS + row * 10**8, row, PilotCommand(driver=driver))
        log.add_metadata("bc.drive", {"autonomy_percent": reported})
    with Log(tmp_path / "x.mcap") as opened:
        readings = Readings(opened)
        read = [readings.at(START_NS + row * 10**8) for row in range(len(drivers))]
        late = readings.at(START_NS + 2 * 10**9)
    assert [reading.driver for reading in read] == ["network", "expert", "human", None]
    assert [reading.time_s for reading in read] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert read[0].autonomy_percent == pytest.approx(expected if expected is not None else math.nan, nan_ok=True)
    assert late.driver is None  # what is more than a second old is not known any more


# What is wrong with the log


def test_a_broken_picture_is_named_and_the_one_before_is_shown(tmp_path: Path, play: Callable[..., Done]) -> None:
    pictures = [grey(50), grey(100), b"no picture", road_jpeg(0)[:-2], grey(200)]
    log = write_log(tmp_path / "x.mcap", pictures)
    done = play(log, "--video", tmp_path / "x.mp4")
    assert done.code == 3
    assert done.stderr == "skipped broken pictures, shown as the one before: 2 (row 2, row 3)\n"
    assert levels(decoded(tmp_path / "x.mp4").frames) == pytest.approx([50, 100, 100, 100, 200], abs=2)


def test_pictures_in_a_damaged_chunk_are_named_too(
    tmp_path: Path, play: Callable[..., Done], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 1)  # a chunk for each
    log = write_log(tmp_path / "x.mcap", [grey(50), grey(100), grey(150), grey(200)])
    data = bytearray(log.read_bytes())
    data[data.index(grey(100)) + 20] ^= 1  # in its header: it would still decode
    log.write_bytes(data)
    done = play(log, "--video", tmp_path / "x.mp4")
    assert done.code == 3
    assert done.stderr == "skipped broken pictures, shown as the one before: 1 (row 1)\n"
    assert levels(decoded(tmp_path / "x.mp4").frames) == pytest.approx([50, 50, 150, 200], abs=2)


def test_a_log_without_a_picture_of_the_centre_camera_makes_no_video(
    tmp_path: Path, play: Callable[..., Done]
) -> None:
    with LogWriter(tmp_path / "left.mcap", {"source": "test"}) as log:
        log.picture("left", START_NS, 0, grey(90))
    broken = write_log(tmp_path / "broken.mcap", [b"no picture"] * 3)
    thin = write_log(tmp_path / "thin.mcap", [png(np.zeros((9000, 1, 3), np.uint8))])
    before = sorted(tmp_path.iterdir())
    for path, expected in (
        (tmp_path / "left.mcap", "no picture of the centre camera"),
        (broken, "none of 3 pictures of the centre camera can be shown"),
        (thin, "pictures of 1 x 9000 pixels"),
    ):
        done = play(path, "--video", tmp_path / "x.mp4")
        assert done.code == 1
        assert expected in done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_of_an_unfinished_log_what_is_whole_is_shown_and_it_is_said(
    tmp_path: Path, play: Callable[..., Done]
) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    whole = write_log(tmp_path / "whole.mcap", [png(noise)] * 10).read_bytes()
    log = tmp_path / "killed.mcap.ab12cd.part"
    log.write_bytes(whole[: len(whole) // 2])
    done = play(log, "--video", tmp_path / "x.mp4", "--overlay")
    assert done.code == 3
    assert "unfinished" in done.stderr
    assert 2 <= len(decoded(tmp_path / "x.mp4").frames) <= 5


# What is wrong elsewhere


def test_an_existing_file_is_kept_unless_it_is_forced(tmp_path: Path, play: Callable[..., Done]) -> None:
    log, video = write_log(tmp_path / "x.mcap", [grey(90)] * 3), tmp_path / "x.mp4"
    video.write_bytes(b"precious")
    with pytest.raises(UserError, match="--force"):
        write_video(log, video)
    assert video.read_bytes() == b"precious"
    assert play(log, "--video", video, "--force").code == 0
    assert len(decoded(video).frames) == 3


@pytest.mark.parametrize("flags", [("--speed", "2"), ("--overlay",), ("--video", "x.mp4", "--web"),
                                   ("--video", "x.mp4", "--connect"), ("--video", "x.mp4", "--by", "place"),
                                   ("--video", "x.gif"), ("--video", "x.mp4", "--speed", "0"),
                                   ("--video", "x.mp4", "--speed", "nan")])  # fmt: skip
def test_flags_that_make_no_sense_are_named(
    tmp_path: Path, play: Callable[..., Done], monkeypatch: pytest.MonkeyPatch, flags: tuple[str, ...]
) -> None:
    log = write_log(tmp_path / "log.mcap", [grey(90)])
    monkeypatch.chdir(tmp_path)
    done = play(log, *flags)
    assert done.code == 2
    assert "--video" in done.stderr or "--speed" in done.stderr
    assert list(tmp_path.iterdir()) == [log]
