"""A page at the wheel: its controls take hold, it is shown frames, and whatever else it sends does no harm."""

from __future__ import annotations

import contextlib
import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from common.users_cache import users_cache
from recorder.teleop.frame_state import road_edges
from recorder.teleop.seat import ABSENT_S, GIVES_UP_S, ControlMessage, Seat, parse_message
from recorder.teleop.wheel import MAX_IN_FLIGHT, Request, Wheel, open_wheels
from simulator.roads.track import load_track
from tests.helpers.waiting import PATIENCE_S, wait_until
from tests.helpers.wheel_page import WheelPage


@pytest.fixture
def wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wheel]:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    with Wheel("lake", tmp_path / "lake.mcap", {"track": "lake"}) as opened:
        yield opened


@contextlib.contextmanager
def two_pages(wheel: Wheel) -> Iterator[tuple[WheelPage, WheelPage]]:
    """Two pages, of which the first has come first: each is served by a thread of its own."""
    with WheelPage() as first:
        wait_until(lambda: wheel.pages == 1)
        with WheelPage() as second:
            wait_until(lambda: wheel.pages == 2)
            yield first, second


def controls(steering: float, number: int = 1, *, touching: bool = True) -> ControlMessage:
    return ControlMessage(number, 1000.0, steering, 0.0, "keyboard", touching)


def test_controls_take_hold_and_carry_their_number_and_time(wheel: Wheel) -> None:
    assert wheel.control().is_absent
    with WheelPage() as page:
        number = page.steer(-0.5, 0.25, device="gamepad", time_ms=1234.5, hold_mph=10)
        control = wait_until(lambda: next((now for now in [wheel.control()] if now.number == number), None))
    assert control is not None
    assert (control.steering, control.throttle, control.hold_mph) == (-0.5, 0.25, 10.0)
    assert (control.device, control.time_ms, control.is_absent) == ("gamepad", 1234.5, False)


def test_a_page_is_greeted_and_shown_each_frame_with_its_picture(wheel: Wheel) -> None:
    with WheelPage() as page:
        hello = page.text("hello")
        assert (hello["title"], hello["track"], hello["log"]) == ("lake", "lake", str(Path.cwd() / "lake.mcap"))
        assert page.text("wheel") == {"type": "wheel", "holder": True, "asked": False, "free": False}
        for number, jpeg in enumerate((b"first", b"second"), 1):
            wheel.show({"speed_mph": 9.5}, jpeg)
            shown = page.frame()
            assert (shown.state, shown.jpeg) == ({"frame": number, "speed_mph": 9.5}, jpeg)


def test_a_page_that_shows_nothing_is_sent_two_frames_and_then_the_newest(wheel: Wheel) -> None:
    with WheelPage() as page:
        page.text("wheel")
        for number in range(1, 10):
            wheel.show({}, b"%d" % number)
            if number <= MAX_IN_FLIGHT:
                assert page.socket.recv(PATIENCE_S)[-1:] == b"%d" % number  # not acknowledged
        page.send("got", frame=1)
        assert page.frame().jpeg == b"9"


def test_a_page_that_goes_lets_go_at_once(wheel: Wheel) -> None:
    with WheelPage() as page:
        page.steer(1.0, 1.0)
        wait_until(lambda: wheel.control().steering == 1.0)
    wait_until(lambda: wheel.pages == 0)
    gone = wheel.control()
    assert (gone.steering, gone.throttle, gone.is_touching) == (0.0, 0.0, False)


def test_silence_of_a_second_is_absence() -> None:
    seat, page = Seat(), object()
    seat.enter(page, 0.0)
    seat.steer(page, controls(0.5), 10.0)
    assert seat.control(10.0 + 0.9 * ABSENT_S).steering == 0.5
    absent = seat.control(10.0 + ABSENT_S)
    assert (absent.steering, absent.is_absent, absent.is_touching) == (0.0, True, False)


def test_a_press_between_two_looks_counts_once() -> None:
    seat, page = Seat(), object()
    seat.enter(page, 0.0)
    seat.steer(page, controls(0.1, 1), 0.1)
    seat.steer(page, controls(0.0, 2, touching=False), 0.2)
    assert [seat.control(0.3).is_touching, seat.control(0.3).is_touching] == [True, False]


def test_controls_that_were_overtaken_are_not_used() -> None:
    seat, page = Seat(), object()
    seat.enter(page, 0.0)
    assert seat.steer(page, controls(0.5, 2), 0.1)
    assert not seat.steer(page, controls(-0.5, 1), 0.2)
    assert seat.control(0.3).steering == 0.5


def test_a_second_page_watches_until_it_is_given_the_wheel(wheel: Wheel) -> None:
    with two_pages(wheel) as (first, second):
        assert first.text("wheel")["holder"]
        assert not second.text("wheel")["holder"]
        second.steer(1.0)
        second.send("end")
        second.send("ask")
        while not first.text("wheel")["asked"]:
            pass
        assert (wheel.control().steering, wheel.requests()) == (0.0, [])
        first.send("give")
        while not second.text("wheel")["holder"]:
            pass
        second.steer(0.75)
        wait_until(lambda: wheel.control().steering == 0.75)


def test_a_watching_page_hears_when_nobody_holds_the_wheel(wheel: Wheel) -> None:
    with two_pages(wheel) as (first, second):
        first.text("wheel")
        assert not second.text("wheel")["free"]
        first.socket.close()
        assert second.text("wheel") == {"type": "wheel", "holder": False, "asked": False, "free": True}
        second.send("ask")
        assert second.text("wheel") == {"type": "wheel", "holder": True, "asked": False, "free": False}


def test_a_page_that_comes_back_has_the_wheel_that_nobody_has_taken(wheel: Wheel) -> None:
    with two_pages(wheel) as (first, second):
        first.text("wheel")
        second.text("wheel")
        first.socket.close()
        while not second.text("wheel")["free"]:
            pass
        with WheelPage() as again:
            assert again.text("wheel")["holder"]


def test_a_silent_holder_loses_the_wheel_to_a_page_that_asks() -> None:
    seat, first, second = Seat(), object(), object()
    seat.enter(first, 0.0)
    seat.enter(second, 0.0)
    seat.steer(first, controls(0.5), 1.0)
    seat.ask(second, 1.0 + 0.9 * GIVES_UP_S)
    assert seat.holder is first
    seat.ask(second, 1.0 + GIVES_UP_S)
    assert seat.holder is second


def test_requests_reach_the_loop_in_their_order(wheel: Wheel) -> None:
    with WheelPage() as page:
        for kind in ("record", "pause", "hand_back", "put_back", "end"):
            page.send(kind)
        page.send("bad", seconds=5)
        requests: list[Request] = []

        def is_complete() -> bool:
            requests.extend(wheel.requests())
            return len(requests) == 6

        wait_until(is_complete)
    expected = ["record", "pause", "hand_back", "put_back", "end", "bad"]
    assert [request.kind for request in requests] == expected
    assert requests[-1].seconds == 5.0


GOOD = {
    "type": "control",
    "number": 1,
    "time_ms": 1.0,
    "steering": 0.0,
    "throttle": 0.0,
    "device": "mouse",
    "touching": False,
}


@pytest.mark.parametrize(
    "wrong",
    [
        {"steering": 1.01},
        {"throttle": -2},
        {"steering": "0"},
        {"number": -1},
        {"device": "thought"},
        {"hold_mph": 1e9},
        {"time_ms": -1.0},
        {"type": "kill"},
    ],
    ids=str,
)
def test_controls_out_of_range_are_none(wrong: dict[str, Any]) -> None:
    assert parse_message(json.dumps(GOOD)) is not None
    assert parse_message(json.dumps({**GOOD, **wrong})) is None


@pytest.mark.parametrize("headers", [{}, {"Authorization": "Bearer x"}], ids=["no token", "another token"])
def test_only_the_token_opens_it(wheel: Wheel, headers: dict[str, str]) -> None:
    port = open_wheels(Path.cwd())[0].port
    with pytest.raises(InvalidStatus, match="401"), connect(f"ws://127.0.0.1:{port}", additional_headers=headers):
        pass


def test_a_browser_is_refused_though_it_had_the_token(wheel: Wheel) -> None:
    opened = open_wheels(Path.cwd())[0]
    headers = {"Authorization": f"Bearer {opened.token}", "Origin": "http://127.0.0.1:8080"}
    address = f"ws://127.0.0.1:{opened.port}"
    with pytest.raises(InvalidStatus, match="403"), connect(address, additional_headers=headers):
        pass


def test_a_wheel_is_listed_for_its_user_and_folder_while_it_lasts(wheel: Wheel, tmp_path: Path) -> None:
    (listed,) = open_wheels(Path.cwd())
    assert (listed.key, listed.title) == (wheel.key, "lake")
    assert open_wheels(tmp_path / "elsewhere") == []
    (file,) = (users_cache() / "wheels").iterdir()
    if os.name == "posix":
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    copy = file.with_name("copy.json")
    copy.write_bytes(file.read_bytes())  # as a process that was killed leaves it
    assert open_wheels(Path.cwd()) == [listed]


def test_the_end_is_the_last_message(wheel: Wheel) -> None:
    with WheelPage() as page:
        page.text("wheel")
        wheel.end({"rows": 42, "why": "asked for"})
        assert page.text("ended")["rows"] == 42
        with pytest.raises(ConnectionClosed):
            page.text("ended")


def test_the_map_has_both_edges_of_the_road() -> None:
    track = load_track("lake")
    edges = road_edges(track)
    assert edges["closed"]
    along_m = np.arange(len(track.half_width_m)) * track.line.step_m
    for name, side in (("left", 1), ("right", -1)):
        for x_m, y_m in np.array(edges[name])[::10]:
            arc_m, offset_m = track.line.project(x_m, y_m)
            assert offset_m == pytest.approx(side * np.interp(arc_m, along_m, track.half_width_m), abs=0.3)
