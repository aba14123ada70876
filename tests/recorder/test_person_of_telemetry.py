"""A person drives a simulator that connects: the page answers its telemetry, and chooses what is recorded."""

from __future__ import annotations

import base64
import itertools
import math
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from recorder import Imported, Log, RecordingError
from recorder.log.tags import read_tags
from recorder.rows.row_quality import States, drive_numbers
from recorder.server import telemetry_server
from recorder.sources.live_telemetry import listen_at_the_wheel
from recorder.sources.settings import ListenSettings
from recorder.teleop import cockpit
from recorder.teleop.pedals import throttle_of_telemetry
from recorder.teleop.seat import Control
from recorder.upkeep.check import check
from tests.helpers.driving import road_jpeg
from tests.helpers.ports import free_ports
from tests.helpers.serving import ModernClient, RawClient
from tests.helpers.waiting import PATIENCE_S
from tests.helpers.wheel_page import Shown, WheelPage


def telemetry(picture: bytes = b"", **changed: object) -> dict[str, object]:
    image = base64.b64encode(picture or road_jpeg(0)).decode()
    return {"steering_angle": "5.0", "throttle": "0.25", "speed": "8.0", "image": image, **changed}


class Drive:
    """A drive in a thread: a simulator, and a page at its wheel."""

    done: Imported
    last: Shown

    def __init__(self, log: Path) -> None:
        self.log = log
        self.error: Exception | None = None
        self.state: dict[str, Any] = {}
        self._pictures = itertools.count()
        (self.port,) = free_ports(1)
        self._listens, self._has_ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @contextmanager
    def running(self) -> Iterator[Drive]:
        self._thread.start()
        self._listens.wait()
        with WheelPage() as self.page, closing(ModernClient(self.port)) as self.simulator:
            yield self
        self._has_ended.wait()

    def drive(self, speed_mph: float, steering: float, throttle: float = 0.0, **more: object) -> dict[str, float]:
        """The answer to a telemetry, once the page's controls are in force."""
        number = self.page.steer(steering, throttle, device="mouse")
        while True:
            picture = road_jpeg(next(self._pictures))  # never twice: that is a frozen camera
            name, command = self.simulator.tell(telemetry(picture, speed=f"{speed_mph}", **more))
            assert name == "steer"
            self.last = self.page.frame()
            self.state = self.last.state
            if self.state["control"] >= number:
                return {field: float(text) for field, text in command.items()}

    def rows(self) -> int:
        """The rows until now, as the page is shown them."""
        return int(self.state["rows"])

    @property
    def is_recording(self) -> bool:
        return bool(self.state["is_recording"])

    def end(self) -> dict[str, object]:
        self.page.send("end")
        return self.page.text("ended")

    def _run(self) -> None:
        settings = ListenSettings(port=self.port, on_started=lambda _: self._listens.set())
        try:
            self.done = listen_at_the_wheel(settings, self.log, 10.0)
        except RecordingError as error:
            self.error = error
        finally:
            self._has_ended.set()


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    # a client that is kept waiting by others is sent nothing unasked
    monkeypatch.setattr(telemetry_server, "FIRST_COMMAND_S", PATIENCE_S)


def test_a_person_answers_telemetry_and_it_is_recorded_as_steered(tmp_path: Path) -> None:
    with Drive(tmp_path / "mine.mcap").running() as drive:
        assert drive.page.text("hello")["kind"] == "listen"
        assert drive.drive(8.0, -0.5, 0.25) == {"steering_angle": -0.5, "throttle": 0.25}
        drive.page.send("record")
        while not (rows := drive.rows()):
            drive.drive(8.0, 0.5, -0.75)
        drive.page.send("pause")
        while drive.rows() > rows or drive.is_recording:
            rows = drive.rows()
            drive.drive(8.0, 0.5)
        drive.drive(0.0, 0.0)
        drive.end()
    with Log(drive.log) as log:
        assert (log.metadata["source"], log.metadata["driver"]) == ("telemetry", "human")
        states = [state for _, state in log.vehicle_states()]
    assert {state.steering for state in states} == {0.2}  # of the wheels: 5 of 25 degrees
    assert {state.Device.Name(state.device) for state in states} == {"MOUSE"}
    assert 0.75 in {state.brake for state in states}
    assert not check(drive.log).findings


def test_one_wheel_steers_one_simulator_and_then_the_one_that_remains(tmp_path: Path) -> None:
    with Drive(tmp_path / "mine.mcap").running() as drive:
        drive.drive(8.0, -0.5, 0.25)
        drive.page.send("record")
        second = RawClient(drive.port)
        second.tell(telemetry(speed="3.0"))
        assert second.command() == ("manual", {})
        while not drive.rows():
            drive.drive(8.0, -0.5, 0.25)
        drive.simulator.close()
        while (state := drive.page.frame().state).get("stalled") != "gone":
            pass
        assert state["speed_mph"] == 8.0
        for touching, steering, expected in [(True, -0.5, 0.0), (False, 0.0, 0.0), (True, 0.75, 0.75)]:
            drive.page.steer(steering, touching=touching)
            drive.page.send("ask")
            drive.page.text("wheel")  # the wheel has the controls: it answers in order
            second.tell(telemetry(speed="3.0"))
            name, command = second.command()
            assert (name, float(command["steering_angle"])) == ("steer", expected)
        while (state := drive.page.frame().state)["speed_mph"] != 3.0:
            pass
        assert "stalled" not in state
        drive.end()
        second.vanish()
    with Log(drive.log) as log:
        states = States.of(log.vehicle())
    drives = drive_numbers(states.time_ns)
    assert set(zip(drives.tolist(), states.speed_mph.tolist(), strict=True)) == {(0, 8.0), (1, 3.0)}
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["mine.mcap"]


def test_the_page_shows_the_last_picture_of_a_silent_simulator(tmp_path: Path) -> None:
    with Drive(tmp_path / "mine.mcap").running() as drive:
        drive.drive(0.0, 0.5)
        picture = drive.last.jpeg
        while not (shown := drive.page.frame()).state.get("stalled"):
            pass
        assert (shown.state["stalled"], shown.jpeg) == ("silent", picture)
        assert 0.0 <= time.time() - shown.state["stalled_since_s"] < PATIENCE_S
        drive.drive(0.0, 0.5)
        assert "stalled" not in drive.state
        drive.end()


def test_a_silent_simulator_is_braked_at_the_end(tmp_path: Path) -> None:
    with Drive(tmp_path / "mine.mcap").running() as drive:
        drive.drive(30.0, 1.0, 1.0)
        drive.page.send("record")
        while not drive.rows():
            drive.drive(30.0, 1.0, 1.0)
        count = len(drive.simulator.answers)
        drive.end()  # it hangs from here on
        drive.simulator.wait_for(count + 2)
        pushed = [(float(data["steering_angle"]), float(data["throttle"])) for _, data in drive.simulator.answers]
    assert pushed[count:][0] == (0.0, -1.0)
    assert pushed[-1] == (0.0, 0.0)


def test_commas_are_answered_with_commas_from_the_first_message(tmp_path: Path) -> None:
    with Drive(tmp_path / "mine.mcap").running() as drive:
        numbers = {"steering_angle": "5,0000", "throttle": "0,2500", "speed": "8,0000"}
        _, command = drive.simulator.tell({**numbers, "image": "?"})  # unusable, but answered
        assert command["steering_angle"] == "0,000000"
        drive.end()


def test_the_last_seconds_can_be_tagged_as_bad(tmp_path: Path) -> None:
    with Drive(tmp_path / "a.mcap").running() as drive:
        drive.drive(8.0, 0.0)
        drive.page.send("record")
        drive.drive(8.0, 0.1)
        while drive.rows() < 5:
            drive.drive(8.0, 0.1)
        drive.page.send("bad", seconds=60)
        drive.drive(0.0, 0.1)
        drive.end()
    with Log(drive.log) as log:
        (tag,) = read_tags(drive.log, log.fingerprint)
    assert (tag.name, tag.first_row) == ("exclude", 0)
    assert tag.last_row >= 4


def test_without_the_simulators_time_nobody_knows_its_pace(tmp_path: Path) -> None:
    with Drive(tmp_path / "a.mcap").running() as drive:
        for _ in range(3):
            drive.drive(0.0, 0.0)
            assert drive.state["pace"] is None
        drive.end()


def test_a_simulators_pace_is_that_of_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr(cockpit, "time", SimpleNamespace(monotonic=lambda: now_s))
    with Drive(tmp_path / "a.mcap").running() as drive:
        for now_s in (1.0, 1.5, 2.0):
            drive.drive(0.0, 0.0, world={"time_s": 1000 + 0.25 * now_s})
        assert drive.state["pace"] == pytest.approx(0.25)
        drive.end()


def test_a_drive_that_recorded_nothing_reports_what_to_do(tmp_path: Path) -> None:
    with Drive(tmp_path / "a.mcap").running() as drive:
        drive.drive(0.0, 0.0)
        assert drive.end()["rows"] == 0
    assert "begin to record on the page" in str(drive.error)
    assert not list(tmp_path.glob("*.mcap*"))


@pytest.mark.parametrize(
    ("control", "speed_mph", "throttle"),
    [
        (Control(throttle=0.3, is_absent=False), 9.0, 0.3),
        (Control(hold_mph=10.0, is_absent=False), 0.0, 1.0),
        (Control(hold_mph=10.0, is_absent=False), 10.0, 0.0),
        (Control(hold_mph=5.0, is_absent=False), 30.0, -1.0),
        (Control(hold_mph=0.0, is_absent=False), 0.2, 0.0),  # braked any longer, it would reverse
        (Control(hold_mph=10.0, is_absent=False), math.nan, 0.0),
        (Control(is_absent=True), 9.0, -1.0),
        (Control(is_absent=True), 0.2, 0.0),
        (Control(is_absent=True), math.nan, 0.0),
    ],
)
def test_the_pedals_of_a_car_whose_speed_alone_is_known(
    control: Control, speed_mph: float, throttle: float
) -> None:
    assert throttle_of_telemetry(control, speed_mph) == pytest.approx(throttle)
