"""A person drives the built-in simulator: what the page sends is what is driven and recorded, at any speed of the
computer."""

from __future__ import annotations

import functools
import itertools
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from common import UserError
from common.car import CAMERAS, Camera
from dataset import build_index
from recorder import Imported, Log, RecordingError
from recorder.cli import main as record_main
from recorder.log.road_places import last_place_m
from recorder.log.tags import Tag, read_tags
from recorder.rows.row_quality import usual_step
from recorder.sources import record_person as person_rows
from recorder.sources.eye_pictures import PictureScale
from recorder.sources.record_person import record_person
from recorder.sources.settings import PersonDrive, check_row_rate, is_row_step
from recorder.teleop.pedals import CoursePedals
from recorder.teleop.seat import Control
from recorder.teleop.wheel import open_wheels
from recorder.upkeep.check import check
from recorder.upkeep.recover import recover
from simulator.driving.course import Course
from simulator.driving.simulation import Simulation
from simulator.pose import Pose
from simulator.roads.track import load_track
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import Process, command, road_jpeg
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.wheel_page import WheelPage


class PersonsPage(WheelPage):
    """A page whose person holds the controls until the drive is in a wanted state."""

    def drive_until(
        self,
        condition: Callable[[dict[str, Any]], object],
        steering: float = 0.0,
        throttle: float = 0.0,
        **more: Any,
    ) -> dict[str, Any]:
        while True:
            self.steer(steering, throttle, **more)
            if condition(state := self.frame().state):
                return state


class Drawn(Simulation):
    """Pictures that cost next to nothing, for what is true whatever they show."""

    def jpeg(self, camera: Camera = "center", pose: Pose | None = None, scale: float = 1.0) -> bytes:
        return road_jpeg(next(self._numbers) % 100)

    @functools.cached_property
    def _numbers(self) -> Iterator[int]:
        return itertools.count()


class Drive:
    """A drive in a thread; `done` is its result when it has ended."""

    done: Imported

    def __init__(self, log: Path, simulation: Simulation | None = None, **settings: Any) -> None:
        self.log = log
        self.error: Exception | None = None
        self._simulation = simulation or Drawn("lake")
        self._settings = PersonDrive(**settings)
        self._is_open = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def end(self, page: WheelPage) -> dict[str, Any]:
        page.send("end")
        return page.text("ended")

    def _run(self) -> None:
        try:
            self.done = record_person(
                self._settings, self.log, simulation=self._simulation, on_wheel=lambda _: self._is_open.set()
            )
        except Exception as error:
            self.error = error
            self._is_open.set()

    @contextmanager
    def page(self) -> Iterator[PersonsPage]:
        self._thread.start()
        self._is_open.wait()
        with PersonsPage() as page:
            yield page
        self._thread.join()


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


def events(path: Path) -> list[str]:
    with Log(path) as log:
        return [event.message for _, event in log.decoded("/events")] if "/events" in log.counts else []


def test_a_drive_is_a_log_of_three_cameras_that_has_who_steered_and_how(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "mine.mcap", Simulation("lake"))
    began_ns = time.time_ns()
    with drive.page() as page:
        hello = page.text("hello")
        page.send("record")
        page.drive_until(lambda state: state["rows"] >= 4, -0.25, 1.0, device="gamepad")
        drive.end(page)
    assert (hello["kind"], hello["session"], hello["track"], hello["hold_mph"]) == ("record", "mine", "lake", 10.0)
    assert not check(drive.log).findings
    with Log(drive.log) as log:
        vehicle = log.vehicle()
        assert log.metadata["driver"] == "human"
        assert log.counts["/camera/center"] == log.counts["/camera/left"] == drive.done.rows
        assert vehicle["steering"].to_pylist()[-1] == -0.25
        assert vehicle["throttle"].to_pylist()[-1] == 1.0
        times_ns = vehicle["log_time_ns"].to_numpy()
        picture = cv2.imdecode(np.frombuffer(log.picture(0), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (160, 320, 3)
    assert set(np.diff(times_ns).tolist()) == {100_000_000}
    assert began_ns < times_ns[0] < time.time_ns()  # the day of the drive
    frames = build_index([drive.log], tmp_path / "index").frames
    assert set(frames["device"].to_pylist()) == {"gamepad"}


def test_20_rows_a_second_fall_on_the_nearest_steps_and_are_no_gaps(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap", rate=20)
    with drive.page() as page:
        page.send("record")
        page.drive_until(lambda state: state["rows"] >= 9, 0.01, 1.0)
        drive.end(page)
    checked = check(drive.log)
    assert (checked.findings, checked.meant_gaps) == ([], [])
    with Log(drive.log) as log:
        vehicle = log.vehicle()
    times_ns, speeds = vehicle["log_time_ns"].to_numpy(), vehicle["speed_mph"].to_numpy()
    assert usual_step(np.diff(times_ns[:9])) == pytest.approx(50_000_000)
    assert usual_step(np.diff(times_ns[:8])) == pytest.approx(50_000_000, rel=0.1)  # one more of a kind
    assert set(np.diff(times_ns[::2]).tolist()) == {100_000_000}
    assert set(np.diff(times_ns).tolist()) == {40_000_000, 60_000_000}
    gained = np.diff(speeds) / np.diff(times_ns)  # as even as the times are true
    assert gained[1:] == pytest.approx(gained[-1], rel=0.1)


@pytest.mark.parametrize("rate_hz", [1, 5, 10, 12.5, 20, 25, 100 / 3, 50])
def test_rows_come_at_the_rate_and_never_pile_up(rate_hz: float) -> None:
    check_row_rate(rate_hz)
    steps = [step for step in range(1, 5001) if is_row_step(step, rate_hz)]
    assert len(steps) == round(100 * rate_hz)
    assert np.ptp(np.diff(steps)) == (0 if (50 / rate_hz).is_integer() else 1)


def test_a_drive_ends_where_the_next_one_can_begin(tmp_path: Path) -> None:
    ends_m: list[float] = []
    for name in ("a", "b"):
        drive = Drive(tmp_path / f"{name}.mcap", start=ends_m[-1] if ends_m else 300.0)
        with drive.page() as page:
            page.send("record")
            page.drive_until(lambda state: state["rows"] >= 2, hold_mph=7.0)
            drive.end(page)
        with Log(drive.log) as log:
            place_m = last_place_m(log)
            assert log.read_metadata("bc.person") == {"hold_mph": "7"}
        assert place_m is not None
        ends_m.append(place_m)
    assert 300 < ends_m[0] < ends_m[1] < 310


def test_a_held_speed_is_kept_without_the_throttle(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap")
    with drive.page() as page:
        page.send("record")
        state = page.drive_until(lambda state: state["speed_mph"] > 4.9, hold_mph=5.0)
        page.drive_until(lambda later: later["time_s"] > state["time_s"] + 1.0, hold_mph=5.0)
        drive.end(page)
    with Log(drive.log) as log:
        assert log.vehicle()["speed_mph"].to_pylist()[-1] == pytest.approx(5.0, abs=0.2)


def test_the_frame_of_a_control_has_its_number_and_its_time(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap", laps=0.001)
    with drive.page() as page:
        number = page.steer(0.5, 1.0, time_ms=1234.5)
        state = page.frame().state
        while state["control"] < number:
            state = page.frame().state
        assert (state["control_time_ms"], state["steering"], state["drives"]) == (1234.5, 0.5, "human")
        page.send("record")
        page.drive_until(lambda state: state["rows"], 0.0, 1.0)
        drive.end(page)


def test_a_car_without_its_person_is_braked_and_nothing_is_recorded(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap")
    with drive.page() as page:
        page.send("record")
        page.drive_until(lambda state: state["speed_mph"] > 3, throttle=1.0)
        state = page.frame().state
        while state["drives"] != "nobody":
            state = page.frame().state
        alone = state["recorded_s"]  # with the rows that still wait to be rendered
        for _ in range(10):
            state = page.frame().state
        assert state["recorded_s"] == alone
        assert state["speed_mph"] == pytest.approx(0.0, abs=0.1)
        page.drive_until(lambda state: state["recorded_s"] > alone, throttle=1.0)
        drive.end(page)
    assert any("nobody was at the wheel" in text for text in events(drive.log))
    assert not check(drive.log).findings


def test_a_car_that_stands_because_nobody_is_there_is_not_stuck(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recorder.sources.record_person.STUCK_S", 0.2)
    drive = Drive(tmp_path / "a.mcap")  # uphill: a little throttle holds the car
    with drive.page() as page:
        state = page.frame().state
        while state["time_s"] < 1:
            state = page.frame().state
        assert (state["drives"], state["throttle"] > 0, state["put_back"]) == ("nobody", True, 0)
        drive.end(page)


@pytest.mark.parametrize("slope_at", [0.1, 0.3, 0.5, 0.7])
def test_an_absent_persons_car_does_not_roll_away(slope_at: float) -> None:
    track = load_track("mountain")
    course = Course(track)
    course.start(slope_at * track.line.length_m)
    pedals = CoursePedals(course)
    begin = course.vehicle
    for _ in range(500):
        course.advance(0.0, pedals.throttle(Control()))
    assert np.hypot(course.vehicle.x_m - begin.x_m, course.vehicle.y_m - begin.y_m) < 0.1


def test_a_pause_is_a_gap_that_an_event_explains(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap")
    with drive.page() as page:
        page.send("record")
        state = page.drive_until(lambda state: state["rows"] >= 3, 0.01, hold_mph=5)
        page.send("pause")
        page.drive_until(lambda later: later["time_s"] > state["time_s"] + 1.5, 0.02, hold_mph=5)
        page.send("record")
        page.drive_until(lambda later: later["recorded_s"] > state["recorded_s"] + 0.3, 0.03, hold_mph=5)
        drive.end(page)
    checked = check(drive.log)
    assert (len(checked.findings), len(checked.meant_gaps)) == (0, 1)
    assert any("the person paused" in text for text in events(drive.log))


@pytest.mark.parametrize("way", ["asked for", "off the road"])
def test_a_car_that_is_put_back_begins_another_drive(tmp_path: Path, way: str) -> None:
    drive = Drive(tmp_path / "a.mcap")
    with drive.page() as page:
        page.send("record")
        page.drive_until(lambda state: state["speed_mph"] > 3, throttle=1.0)
        if way == "asked for":
            page.send("put_back")
        state = page.drive_until(lambda state: state["put_back"], float(way != "asked for"), 1.0)
        page.drive_until(lambda later: later["recorded_s"] > state["recorded_s"] + 0.3, 0.01, hold_mph=5)
        drive.end(page)
    checked = check(drive.log)
    assert (len(checked.findings), len(checked.meant_gaps)) == (0, 1)
    frames = build_index([drive.log], tmp_path / "index").frames
    assert set(frames["drive"].to_pylist()) == {0, 1}


def test_bad_driving_is_tagged_and_never_learnt(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap", rate=25)
    with drive.page() as page:
        page.send("record")
        page.drive_until(lambda state: state["rows"] >= 12, 0.01, hold_mph=5)
        page.send("bad", seconds=0.2)
        page.text("event")
        drive.end(page)
    with Log(drive.log) as log:
        (tag,) = read_tags(drive.log, log.fingerprint)
    assert tag.name == "exclude"
    assert tag.last_row - tag.first_row + 1 == 5
    assert f"driven badly: rows {tag.first_row} to {tag.last_row}" in events(drive.log)


def test_a_drive_without_a_row_leaves_no_log(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap")
    with drive.page() as page:
        page.drive_until(lambda state: state["time_s"] > 0.1)
        assert drive.end(page)["rows"] == 0
    assert isinstance(drive.error, RecordingError)
    assert not list(tmp_path.glob("*.mcap*"))


def test_the_page_is_reported_why_the_disk_ended_the_drive(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "full.mcap")
    with drive.page() as page:
        page.send("record")
        page.drive_until(lambda state: state["rows"] >= 2, hold_mph=10)
        with files_of_at_most(2000):
            assert "make room and run" in page.text("ended")["why"]
    assert isinstance(drive.error, UserError)


def test_the_laps_that_were_asked_for_end_the_drive(tmp_path: Path) -> None:
    drive = Drive(tmp_path / "a.mcap", laps=0.002)
    with drive.page() as page:
        page.send("record")
        while True:
            page.steer(0.0, 1.0)
            if isinstance(message := page._next(), dict) and message["type"] == "ended":
                break
    assert message["why"] == "0.002 laps are driven"
    assert message["rows"] == drive.done.rows > 0


class SlowSimulation(Drawn):
    """A computer that takes long for a picture."""

    def jpeg(self, camera: Camera = "center", pose: Pose | None = None, scale: float = 1.0) -> bytes:
        time.sleep(0.04)
        return super().jpeg(camera, pose, scale)


def test_on_a_slow_computer_the_clock_slows_down_and_no_row_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(person_rows, "MAX_WAITING", 3)
    drive = Drive(tmp_path / "a.mcap", SlowSimulation("lake"), rate=25)
    with drive.page() as page:
        page.send("record")
        state = page.drive_until(lambda state: state["rows"] >= 15, 0.01, 1.0)
        drive.end(page)
    assert state["pace"] < 0.6  # 0.12 s for the pictures of every 0.04 s
    with Log(drive.log) as log:
        vehicle = log.vehicle()
        assert vehicle["row"].to_pylist() == list(range(drive.done.rows))
        assert set(np.diff(vehicle["log_time_ns"].to_numpy()).tolist()) == {40_000_000}
        speeds = vehicle["speed_mph"].to_numpy()
        assert {log.counts[f"/camera/{camera}"] for camera in CAMERAS} == {drive.done.rows}
    assert np.diff(speeds)[2:].std() < 0.02  # even steps at full throttle: none was skipped, none was longer
    assert not check(drive.log).findings


def test_a_killed_drive_is_recovered_with_its_tags(tmp_path: Path) -> None:
    line = command("bc-record", "me", "mine", "--no-page", "--sessions", tmp_path)
    with Process(line) as process:
        wait_until(lambda: open_wheels(Path.cwd()))
        with PersonsPage() as page:
            page.send("record")
            page.drive_until(lambda state: state["rows"] >= 8, hold_mph=5)
            page.send("bad", seconds=0.3)
            page.text("event")
            (part,) = tmp_path.glob("*.part")
            wait_until(lambda: b"driven badly" in part.read_bytes())
            process.end(signal.SIGKILL)
    recovered = recover(part, tmp_path / "mine.mcap")
    assert recovered.rows >= 8
    with Log(recovered.path) as log:
        assert log.metadata["driver"] == "human"
        (tag,) = read_tags(recovered.path, log.fingerprint)
    assert isinstance(tag, Tag)
    assert tag.last_row - tag.first_row + 1 == 3
    assert not check(recovered.path).findings


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("me", "x", "--noise", "0.1"), "--noise"),
        (("me", "x", "--rate", "7"), "--rate 7"),
        (("me", "x", "--laps", "0"), "--laps 0"),
        (("me", "x", "--start", "nan"), "--start nan"),
        (("listen", "x", "--me", "--start", "9"), "--start"),
        (("listen", "x", "--port", "65536"), "--port 65536"),
        (("listen", "x", "--idle", "nan"), "--idle nan"),
        (("listen", "x", "--open", "--no-page"), "--open, --no-page: only with --me"),
    ],
)
def test_flags_that_are_others_than_a_persons_are_refused(
    tmp_path: Path, arguments: tuple[str, ...], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(record_main, *arguments, "--sessions", tmp_path / "sessions") == 2
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "sessions").exists()


def test_eye_pictures_shrink_on_a_slow_computer_and_grow_again() -> None:
    scale = PictureScale()
    assert scale.scale == 2.0
    for _ in range(20):
        scale.note(0.1)
    assert scale.scale == 1.0
    assert sum(not scale.is_recorded_enough() for _ in range(100)) == 10  # rendered, to see if there is room
    for _ in range(200):
        scale.note(0.002)
    assert scale.scale == 2.0
    assert not scale.is_recorded_enough()
