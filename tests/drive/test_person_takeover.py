"""A person supervises a network: the first touch takes over with the next command, a word hands back."""

from __future__ import annotations

import base64
import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from common import UserError
from drive.at_wheel import AtWheel
from drive.config import DriveConfig
from drive.control.takeover import NOBODY, NOBODY_BRAKED, PILOT_DRIVES
from drive.drive_flags import with_default_driver
from drive.drive_server import DriveServer
from model import load_pilot
from recorder import Log
from recorder.bc_pb2 import PilotCommand
from recorder.log.tags import Tag, read_tags
from recorder.server.telemetry_server import Steer
from recorder.teleop.wheel import Wheel
from recorder.topics import DEVICES
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.logs import read_messages
from tests.helpers.waiting import wait_until
from tests.helpers.wheel_page import WheelPage

PERSON = 0.625  # what no network here answers


def telemetry(speed_mph: float) -> dict[str, str]:
    image = base64.b64encode(road_jpeg(0)).decode()
    return {"steering_angle": "0", "throttle": "0", "speed": f"{speed_mph:.4f}", "image": image}


@dataclass
class Supervised:
    """A drive with a person at its wheel, and a simulator that sends a telemetry when the test says so."""

    server: DriveServer
    wheel: Wheel
    page: WheelPage
    log: Path

    def drive(self, speed_mph: float = 9.0, simulator: str = "simulator") -> Steer:
        answer = self.server.telemetry(simulator, telemetry(speed_mph), time.perf_counter())
        answer.on_sent(1.0)
        assert answer.command is not None
        return answer.command

    def sent(self) -> None:
        """Wait until what the page has sent is there: the wheel answers in order."""
        self.page.send("ask")
        self.page.text("wheel")

    def steer(self, steering: float = PERSON, throttle: float = 0.25, **values: Any) -> int:
        number = self.page.steer(steering, throttle, **values)
        self.sent()
        return number

    def hand_back(self) -> None:
        self.page.steer(0.0, touching=False)
        self.page.send("hand_back")
        self.sent()


@pytest.fixture
def supervised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Supervised]:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    pilot, log = load_pilot(untrained_run(tmp_path / "first")), tmp_path / "run.mcap"
    with (
        Wheel("first", log, {"kind": "drive"}) as wheel,
        DriveServer(pilot, DriveConfig(), log, port=0, at_wheel=AtWheel(wheel, DriveConfig())) as server,
        WheelPage() as page,
    ):
        server.connected("simulator")
        page.text("wheel")
        yield Supervised(server, wheel, page, log)


def rows(log: Path) -> list[tuple[int, float]]:
    with Log(log) as opened:
        return [(command.driver, command.steering) for _, command in opened.commands()]


def test_the_first_touch_drives_from_the_next_command_on(supervised: Supervised) -> None:
    networks = supervised.drive().steering
    supervised.steer()
    taken = supervised.drive()
    assert (taken.steering, taken.throttle) == (PERSON, 0.25)
    supervised.hand_back()
    assert supervised.drive().steering == networks


@pytest.mark.parametrize("times", [50, pytest.param(1000, marks=pytest.mark.long)])
def test_no_answer_of_the_network_is_sent_after_a_takeover(supervised: Supervised, times: int) -> None:
    of_the_network = 0
    for _ in range(times):
        supervised.drive()
        supervised.steer()
        of_the_network += sum(supervised.drive().steering != PERSON for _ in range(3))
        supervised.hand_back()
    assert of_the_network == 0


def test_letting_go_of_the_keys_is_not_handing_back(supervised: Supervised) -> None:
    supervised.steer()
    supervised.drive()
    supervised.steer(0.0, 0.0, touching=False)
    assert supervised.drive().steering == 0.0


def test_a_person_who_goes_leaves_the_wheel_to_the_network(supervised: Supervised) -> None:
    networks = supervised.drive().steering
    supervised.steer()
    assert supervised.drive().steering == PERSON
    supervised.page.socket.close()
    wait_until(lambda: supervised.drive().steering == networks)


def test_a_silent_simulator_gets_the_newest_command_of_a_person(
    supervised: Supervised, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drive.drive_session.WATCHDOG_S", 0.0)
    supervised.steer(1.0, 1.0)
    supervised.drive()
    supervised.steer(-0.25, 0.5)
    assert supervised.server.session.watchdog_steer() == Steer(-0.25, 0.5)
    supervised.drive()
    supervised.steer(-0.25, -1.0)  # a brake that is kept for ever would reverse the car
    assert supervised.server.session.watchdog_steer() == Steer(-0.25, 0.0)


def test_a_silent_simulator_gets_nothing_of_a_person_who_has_gone(
    supervised: Supervised, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else its car would keep full lock and full throttle for ever."""
    monkeypatch.setattr("drive.drive_session.WATCHDOG_S", 0.0)
    networks = supervised.drive()
    supervised.steer(1.0, 1.0)
    assert supervised.drive().steering == 1.0
    supervised.page.socket.close()
    wait_until(lambda: supervised.wheel.control().is_absent)
    pushed = supervised.server.session.watchdog_steer()
    assert pushed is not None
    assert pushed.steering == networks.steering
    assert pushed.throttle == pytest.approx(networks.throttle, abs=0.01)
    with supervised.server:
        pass  # finishes the log
    assert NOBODY in [event.message for _, event in read_messages(supervised.log)["/events"]]


def test_a_person_who_goes_while_the_car_is_braked_leaves_the_brake_on(supervised: Supervised) -> None:
    supervised.steer()
    supervised.drive()
    supervised.server.stop()
    supervised.page.socket.close()
    wait_until(lambda: supervised.wheel.control().is_absent)
    assert supervised.drive().throttle == -1.0
    with supervised.server:
        pass  # finishes the log
    events = [event.message for _, event in read_messages(supervised.log)["/events"]]
    assert NOBODY_BRAKED in events
    assert NOBODY not in events


def test_the_brake_comes_before_the_speed_that_is_held(supervised: Supervised) -> None:
    supervised.steer(throttle=-1.0, hold_mph=10)
    assert supervised.drive().throttle == -1.0
    supervised.steer(throttle=0.0, hold_mph=30)
    assert supervised.drive(speed_mph=9.0).throttle > 0.5


def test_the_page_hears_who_takes_over_and_that_the_network_drives_again(supervised: Supervised) -> None:
    supervised.steer()
    supervised.drive()
    assert supervised.page.text("event")["text"] == "a person takes over"
    supervised.hand_back()
    supervised.drive()
    assert supervised.page.text("event")["text"] == PILOT_DRIVES


def test_a_telemetry_without_a_picture_is_still_the_persons(supervised: Supervised) -> None:
    supervised.steer()
    broken = {"steering_angle": "0", "throttle": "0", "speed": "9", "image": "none"}
    answer = supervised.server.telemetry("simulator", broken, time.perf_counter())
    assert answer.command is not None
    assert answer.command.steering == PERSON


def test_the_page_sees_who_drives_and_what_the_network_would_steer(supervised: Supervised) -> None:
    networks = supervised.drive().steering
    first = supervised.page.frame()
    assert (first.state["drives"], first.state["device"], first.jpeg) == ("pilot", None, road_jpeg(0))
    number = supervised.steer(device="gamepad")
    supervised.drive()
    state = supervised.page.frame().state
    assert (state["drives"], state["device"], state["control"]) == ("human", "gamepad", number)
    assert (state["steering"], state["takeovers"], state["rows"]) == (PERSON, 1, 2)
    assert state["predicted"] == pytest.approx(networks)


def test_the_log_and_the_summary_count_the_persons_takeovers(supervised: Supervised) -> None:
    networks = supervised.drive().steering
    for _ in range(2):
        supervised.steer()
        supervised.drive()
        supervised.hand_back()
        supervised.drive()
    summary = supervised.server.session.summary
    assert (summary.manual_stretches, summary.interventions) == (2, 2)
    with supervised.server:
        pass  # finishes the log
    person, network = (PilotCommand.HUMAN, PERSON), (PilotCommand.PILOT, pytest.approx(networks))
    assert rows(supervised.log) == [network, person, network, person, network]
    with Log(supervised.log) as log:
        assert [DEVICES[number] for number in log.devices()] == ["", "keyboard", "", "keyboard", ""]
    ended = supervised.page.text("ended")
    assert (ended["rows"], [takeover["row"] for takeover in ended["takeovers"]]) == (5, [1, 3])


def test_the_wheel_follows_the_simulator_that_remains(supervised: Supervised) -> None:
    supervised.drive()
    supervised.page.send("bad", seconds=60)
    supervised.sent()
    second_log = supervised.log.with_stem("run-2")
    supervised.drive(simulator="second")
    supervised.steer()
    assert supervised.drive().steering == PERSON
    assert supervised.drive(simulator="second").steering != PERSON
    supervised.server.tick()
    supervised.server.disconnected("simulator", "gone")
    supervised.steer()  # a key is still held
    assert supervised.drive(simulator="second").steering != PERSON
    supervised.steer(0.0, touching=False)
    supervised.steer()
    assert supervised.drive(simulator="second").steering == PERSON
    supervised.page.send("bad", seconds=60)
    supervised.page.send("end")
    supervised.sent()
    supervised.server.tick()
    assert any(session.is_end_asked for session in supervised.server.sessions)
    with supervised.server:
        pass  # finishes the logs
    for path, rows in ((supervised.log, Tag(0, 0, "exclude")), (second_log, Tag(2, 3, "exclude"))):
        with Log(path) as log:
            assert read_tags(path, log.fingerprint) == [rows]


@pytest.mark.parametrize("why", ["silent", "gone"])
def test_the_page_shows_that_the_simulator_is_silent_or_gone(
    supervised: Supervised, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervised.drive()
    assert "stalled" not in supervised.page.frame().state
    if why == "silent":
        monkeypatch.setattr("recorder.teleop.wheel.STALLED_S", 0.0)
    else:
        supervised.server.disconnected("simulator", "gone")
    for _ in range(3):
        supervised.server.tick()
    shown = supervised.page.frame()
    assert (shown.state["stalled"], shown.jpeg) == (why, road_jpeg(0))
    supervised.drive(speed_mph=3.0)
    frame = supervised.page.frame()  # the next one: it was sent once
    assert (frame.state.get("stalled"), frame.state["speed_mph"]) == (None, 3.0)


def test_the_last_seconds_are_tagged_as_bad(supervised: Supervised) -> None:
    """Rows come as fast as the test asks for them: all are of the last minute."""
    for _ in range(3):
        supervised.drive()
    supervised.page.send("bad", seconds=60)
    supervised.sent()
    supervised.drive()
    with supervised.server:
        pass  # finishes the log
    with Log(supervised.log) as log:
        assert read_tags(supervised.log, log.fingerprint) == [Tag(0, 2, "exclude")]


def test_no_command_puts_back_the_car_of_another_simulator(supervised: Supervised) -> None:
    supervised.page.send("put_back")
    supervised.sent()
    assert not supervised.drive().puts_back


def test_the_page_ends_the_drive(supervised: Supervised) -> None:
    supervised.drive()
    supervised.page.send("end")
    supervised.sent()
    supervised.server.tick()
    assert supervised.server.session.is_end_asked


def test_the_page_shows_why_the_log_cannot_be_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    pilot, log = load_pilot(untrained_run(tmp_path / "first")), tmp_path / "run.mcap"
    with contextlib.ExitStack() as stack:
        with (
            contextlib.suppress(UserError),
            Wheel("first", log, {"kind": "drive"}) as wheel,
            DriveServer(pilot, DriveConfig(), log, port=0, at_wheel=AtWheel(wheel, DriveConfig())) as server,
        ):
            page = stack.enter_context(WheelPage())
            server.connected("simulator")
            server.telemetry("simulator", telemetry(9.0), time.perf_counter()).on_sent(1.0)
            stack.enter_context(files_of_at_most(2000))
        assert "cannot be written any further" in page.text("ended")["why"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], []),
        (["first", "--takeover"], ["first", "--takeover", "expert"]),
        (["--takeover", "first"], ["--takeover", "expert", "first"]),
        (["--takeover", "me"], ["--takeover", "me"]),
        (["--takeover", "expert", "--laps", "2"], ["--takeover", "expert", "--laps", "2"]),
    ],
    ids=str,
)
def test_a_bare_takeover_is_the_experts(words: list[str], expected: list[str]) -> None:
    assert with_default_driver(words) == expected
