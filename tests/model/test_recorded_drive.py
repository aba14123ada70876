"""Driving a recording: who steers as it was driven stays on its line, who does not leaves it as geometry says."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from common import UserError
from common.car import Camera
from dataset.preprocessing import Image
from drive.evaluation.eval_cli import main as eval_main
from driving import one_line_in, untrained_run
from logs import START_NS
from model.errors import RunError
from model.evaluation.recorded_drive import drive_recording
from painted_road import render
from recorder import Log, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.session_car import UDACITY
from recorder.log.tags import Tag, add_tags
from recorder.upkeep.edit import merge
from udacity import call

MPH = 0.44704  # metres a second
CAMERAS: tuple[Camera, ...] = ("center", "left", "right")
GRAY = np.full((160, 320, 3), 128, np.uint8)


def jpeg(picture: Image) -> bytes:
    ok, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert ok
    return encoded.tobytes()


def record(
    path: Path,
    steering: Sequence[float],
    speed_mph: Sequence[float] | float = 20.0,
    picture: Callable[[Camera], bytes] = lambda camera: jpeg(GRAY),
    step_s: Sequence[float] | float = 0.1,
    source: str = "udacity",
    commands: Sequence[float] = (),
) -> Path:
    """A log of one row for each steering; the pictures are those of every row. `commands` are an expert's."""
    count = len(steering)
    speeds, steps = (np.broadcast_to(values, count).tolist() for values in (speed_mph, step_s))
    pictures = {camera: picture(camera) for camera in CAMERAS}
    time_ns = START_NS
    with LogWriter(path, {"source": source}) as writer:
        for row in range(count):
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, pictures[camera])
            state = VehicleState(steering=steering[row], throttle=0.5, brake=0.0, speed_mph=speeds[row])
            writer.vehicle(time_ns, row, state)
            if commands:
                command = PilotCommand(driver=PilotCommand.EXPERT, steering=commands[row])
                writer.command(time_ns, row, command)
            time_ns += round(steps[row] * 1e9)
    return path


def always(steering: float) -> Callable[[Image], float]:
    return lambda crop: steering


def test_who_steers_as_it_was_driven_stays_on_the_line(tmp_path: Path) -> None:
    drive = drive_recording(always(0.3), record(tmp_path / "bend.mcap", [0.3] * 100))
    assert (drive.rows, drive.stretches, drive.rows_left_out, drive.interventions) == (100, 1, 0, 0)
    assert drive.max_offset_m < 1e-6
    assert drive.autonomy_percent == 100
    assert drive.known_share == 1
    assert drive.driven_s == pytest.approx(9.9)
    assert drive.distance_m == pytest.approx(9.9 * 20 * MPH)


@pytest.mark.parametrize("rate_hz", [2, 9, 60])
def test_also_where_somebody_pressed_keys_and_rows_are_far_apart(tmp_path: Path, rate_hz: float) -> None:
    """Whatever the rate, and however the steering jumps: no way home is needed by who never left the line."""
    steering = np.random.default_rng(0).choice([-1.0, 0.0, 0.0, 0.6], round(8 * rate_hz)).tolist()
    step_s = (np.random.default_rng(1).uniform(0.7, 1.3, len(steering)) / rate_hz).tolist()
    log = record(tmp_path / "keys.mcap", steering, 25.0, step_s=step_s, picture=lambda camera: jpeg(GRAY[:4, :8]))
    answers = iter(steering)
    drive = drive_recording(lambda crop: next(answers), log, departure_m=0.5)
    assert (drive.rows, drive.interventions) == (len(steering), 0)
    assert drive.max_offset_m < 1e-6


def test_the_line_is_that_of_the_wheels_not_of_the_experts_command(tmp_path: Path) -> None:
    log = record(tmp_path / "expert.mcap", [0.3] * 60, commands=[-0.2] * 60, source="drive")
    assert drive_recording(always(0.3), log).max_offset_m < 1e-6
    assert drive_recording(always(-0.2), log).interventions > 0


def test_what_is_tagged_exclude_is_not_driven(tmp_path: Path) -> None:
    path = record(tmp_path / "tagged.mcap", [0.0] * 100)
    with Log(path) as log:
        fingerprint = log.fingerprint
    add_tags(path, fingerprint, [Tag(40, 49, "exclude")])
    add_tags(path, fingerprint, [Tag(70, 79, "fog")])
    drive = drive_recording(always(0.0), path)
    assert [moment.row for moment in drive.moments] == [*range(40), *range(50, 100)]
    assert (drive.stretches, drive.rows_left_out) == (2, 10)
    add_tags(path, fingerprint, [Tag(0, 99, "exclude")])
    with pytest.raises(UserError, match="no tag exclude"):
        drive_recording(always(0.0), path)


@pytest.mark.parametrize("steering", [0.04, -0.04])
def test_who_steers_otherwise_leaves_it_on_a_circle(tmp_path: Path, steering: float) -> None:
    """Off a straight line: after a way s along it the car has turned by asin(s / radius), but for the way that it
    makes before its wheels have turned."""
    log = record(tmp_path / "straight.mcap", [0.0] * 24)
    drive = drive_recording(always(steering), log, departure_m=50.0)
    radius_m = UDACITY.wheelbase_m / math.tan(math.radians(25) * steering)
    for number, moment in enumerate(drive.moments[5:], 5):
        angle = math.asin((number * 0.1 - UDACITY.lag_s) * 20 * MPH / radius_m)
        assert moment.turn_rad == pytest.approx(-angle, abs=2e-3)
        assert moment.left_m == pytest.approx(-radius_m * (1 - math.cos(angle)), abs=0.02)


def test_beyond_the_departure_the_car_is_put_back_for_six_seconds(tmp_path: Path) -> None:
    log = record(tmp_path / "straight.mcap", [0.0] * 101, speed_mph=20)
    drive = drive_recording(always(0.1), log, departure_m=0.5)
    # s² / (2 radius) = 0.5 m is reached after this many rows of 0.1 s; then it begins anew
    radius_m = UDACITY.wheelbase_m / math.tan(math.radians(2.5))
    rows_each = math.ceil(math.sqrt(2 * radius_m * 0.5) / (0.1 * 20 * MPH))
    assert drive.interventions == 100 // rows_each
    assert drive.max_offset_m <= 0.5
    assert drive.autonomy_percent == pytest.approx(max(0.0, 100 * (1 - 6 * drive.interventions / 10)))


def test_a_network_that_sees_where_it_is_comes_back(tmp_path: Path) -> None:
    """The road has a white line under the middle of the recorded car. The network steers towards it, wherever it
    is seen: whatever the recording's own steering (which it does not know) does, it comes back."""

    def road(camera: Camera) -> bytes:
        beside_m = UDACITY.left_m[camera]
        painted = render(UDACITY, beside_m=beside_m) // 4
        for row in range(64, 160):  # columns at which the ground is 0.15 m or less from the middle
            metres = UDACITY.height_m / (row + 0.5 - 60)
            across = (np.arange(320) + 0.5 - 160) * metres - beside_m
            painted[row, np.abs(across) < 0.15] = 255
        return jpeg(painted)

    def towards_the_line(crop: Image) -> float:
        columns = np.flatnonzero(crop[60:70].min(axis=2).mean(axis=0) > 120)
        return 0.02 * (float(columns.mean()) - 63.5) if len(columns) else 0.0

    wavy = [0.08 if row // 6 % 2 else -0.08 for row in range(120)]
    log = record(tmp_path / "wavy.mcap", wavy, 15, road)
    seeing, blind = drive_recording(towards_the_line, log), drive_recording(always(0.03), log)
    assert seeing.interventions == 0
    assert seeing.mean_offset_m < 0.35
    assert blind.interventions > 2


def test_gaps_standing_manoeuvres_and_hits_are_borders_of_counting(tmp_path: Path) -> None:
    speed = [5.5] * 60 + [4.5] * 10 + [5.5] * 40 + [30.0] * 40 + [12.0] * 40
    steps = [0.1] * len(speed)
    steps[29] = 60.0
    log = record(tmp_path / "borders.mcap", [0.0] * len(speed), speed, step_s=steps)
    drive = drive_recording(always(0.0), log)
    # a minute's gap; ten slow rows; 30 to 12 mph in a tenth of a second, and the second before and after
    assert drive.stretches == 4
    assert drive.rows == 30 + 30 + (80 - 11) + (40 - 10)
    assert drive.rows_left_out == len(speed) - drive.rows
    assert drive.interventions == 0
    begins = {moment.row for moment in drive_recording(always(0.2), log).moments if moment.left_m == 0.0}
    assert begins >= {0, 30, 70, 160}


def test_what_cannot_be_driven_is_refused_with_what_was_expected(tmp_path: Path) -> None:
    for name, log in {
        "slow": record(tmp_path / "slow.mcap", [0.0] * 30, 3.0),
        "short": record(tmp_path / "short.mcap", [0.0] * 10),
        "unsteered": record(tmp_path / "unsteered.mcap", [math.nan] * 30),
        "unknown speed": record(tmp_path / "unknown.mcap", [0.0] * 30, math.nan),
        "other camera": record(tmp_path / "other.mcap", [0.0] * 30, source="donkeycar"),
    }.items():
        says = "does not describe its cameras" if name == "other camera" else "nothing in it can be driven"
        with pytest.raises(UserError, match=says) as caught:
            drive_recording(always(0.0), log)
        assert str(log) in str(caught.value), name
    assert drive_recording(always(0.0), tmp_path / "other.mcap", car="udacity").rows == 30
    with pytest.raises(RunError, match="not a number"):
        drive_recording(always(math.nan), record(tmp_path / "whole.mcap", [0.0] * 30))


def test_a_merged_log_is_of_the_car_that_all_its_logs_are_of(tmp_path: Path) -> None:
    one, two = (record(tmp_path / f"{name}.mcap", [0.0] * 30) for name in ("one", "two"))
    tub = record(tmp_path / "tub.mcap", [0.0] * 30, source="donkeycar")
    merge([one, two], tmp_path / "both.mcap")
    merge([tmp_path / "both.mcap", one], tmp_path / "again.mcap")
    assert drive_recording(always(0.0), tmp_path / "both.mcap").rows == 60
    assert drive_recording(always(0.0), tmp_path / "again.mcap").rows == 90
    merge([one, tub], tmp_path / "mixed.mcap")
    with pytest.raises(UserError, match="does not describe its cameras"):
        drive_recording(always(0.0), tmp_path / "mixed.mcap")


def test_undecodable_pictures_are_named_and_the_car_is_put_back_behind(tmp_path: Path) -> None:
    log = record(tmp_path / "broken.mcap", [0.0] * 30, picture=lambda camera: b"\xff\xd8 no more")
    with pytest.raises(UserError, match="nothing in it can be driven"):
        drive_recording(always(0.0), log)


def test_bc_eval_drives_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sessions").mkdir()
    for name in ("one", "two"):
        record(tmp_path / "sessions" / f"{name}.mcap", [0.0] * 30)
    run = untrained_run(tmp_path / "runs" / "toy")
    flags = ("toy", "--on", "one", "two", "--precision", "float32")
    assert call(eval_main, *flags) == 0
    table = capsys.readouterr().out
    assert all(word in table for word in ("one", "two", "interventions"))
    assert call(eval_main, *flags, "--departure", 0.5, "--json") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["session"] for line in lines] == ["one", "two"]
    assert {line["run"] for line in lines} == {run.name}
    assert {line["departure_m"] for line in lines} == {0.5}
    assert {"interventions", "autonomy_percent", "distance_m", "mean_offset_m", "max_offset_m"} <= lines[0].keys()


@pytest.mark.parametrize(
    ("flags", "code", "says"),
    [
        (("--departure", 1), 2, "--departure: only with --on"),
        (("--on", "one", "--laps", 1), 2, "--laps: only with --simulator"),
        (("--on", "one", "--session", "one"), 2, "--session: of recorded frames"),
        (("--on", "one", "--simulator", "lake"), 2, "one or the other"),
        (("--on", "one", "one"), 2, "give each once"),
        (("--on",), 2, "--on at least one"),
        (("--on", "one", "--departure", 0), 2, "--departure 0"),
        (("--on", "nobody"), 1, "nobody.mcap: no such log"),
    ],
)
def test_contradictions_and_mistakes_are_one_line(
    flags: tuple[object, ...],
    code: int,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(eval_main, *flags) == code
    assert says in one_line_in(capsys)
