"""A person at the wheel in a real browser: keys, a mouse, a finger and a gamepad steer a real driving loop."""

from __future__ import annotations

import contextlib
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from recorder import Log
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import command, environment
from tests.helpers.pages import opened_page, window_of, with_token
from tests.helpers.ports import free_ports
from tests.helpers.waiting import wait_until
from tests.helpers.wheel_host import PREDICTED, Host, driving_host
from tests.helpers.workbench import Served, served
from web.server.templates import STATIC

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PADS = """pads => {
  navigator.getGamepads = () => pads.map(pad => pad && {connected: true, mapping: 'standard', ...pad,
    buttons: Array.from({length: 17}, (_, at) => ({value: pad.pressed?.[at] ?? 0}))});
  dispatchEvent(new Event('gamepadconnected'));
}"""


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with served(tmp_path) as server:
        yield server


@pytest.fixture
def host(bench: Served) -> Iterator[Host]:
    with driving_host(bench.folder / "sessions" / "lake-1.mcap") as started:
        yield started


@contextlib.contextmanager
def at_wheel(browser: Browser, bench: Served, host: Host) -> Iterator[Page]:
    with opened_page(browser, f"{bench.address}{host.address}") as page:
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        yield page


def steered(host: Host, steering: float, device: str) -> None:
    """Wait until the loop is steered so."""
    wait_until(lambda: (host.control.steering, host.control.device) == (steering, device))


def test_keys_steer_by_unitys_rule(browser: Browser, bench: Served) -> None:
    """3 of full lock a second, there and back; an opposite key jumps to 0 first; both at once are none."""
    with window_of(browser, 1280, 800) as page:
        page.goto(with_token(f"{bench.address}/wheel"))
        steering = page.evaluate(
            """async () => {
              const { Keys } = await import('STATIC/js/wheel/keys.js');
              const keys = new Keys();
              const after = (seconds, change) => { change?.(); keys.advance(seconds); return keys.steering; };
              return [
                after(0.1, () => keys.down('ArrowLeft')), after(0.1), after(0.2),
                after(0.1, () => keys.down('KeyD')), after(0.3),
                after(0.1, () => keys.up('ArrowLeft')), after(0.1, () => keys.up('KeyD')),
                after(0.2, () => keys.down('KeyD')), (keys.up('KeyD'), after(0.1, () => keys.down('KeyA'))),
                after(0, () => keys.release()),
              ];
            }""".replace("STATIC", STATIC)
        )
    left, both, right, snapped = [-0.3, -0.6, -1], [-0.7, 0], [0.3, 0], [0.6, -0.3, 0]
    assert steering == pytest.approx([*left, *both, *right, *snapped])


@pytest.mark.parametrize(
    ("is_connected", "text"), [(True, "The simulator has been silent since "), (False, "The simulator has gone. ")]
)
def test_the_picture_of_a_silent_simulator_is_dimmed_until_it_goes_on(
    browser: Browser, bench: Served, host: Host, is_connected: bool, text: str
) -> None:
    def is_dimmed() -> bool:
        host.wheel.note_silence(5.0, is_connected=is_connected)
        # A frame that was on its way may arrive after it.
        return bool(page.query_selector("#cockpit.stalled")) and page.inner_text("#recording") == "no new rows"

    with at_wheel(browser, bench, host) as page:
        assert page.is_hidden("#stalled")
        page.keyboard.press("r")
        page.wait_for_selector("#recording.on")
        host.is_silent = True
        wait_until(is_dimmed)
        assert page.inner_text("#stalled").startswith(text)
        host.is_silent = False
        page.wait_for_selector("#stalled", state="hidden")
        page.wait_for_selector("#recording.on")
        assert not page.query_selector("#cockpit.stalled")


def test_keys_drive_the_car_and_are_let_go_when_the_window_loses_focus(
    browser: Browser, bench: Served, host: Host
) -> None:
    with at_wheel(browser, bench, host) as page:
        page.keyboard.down("ArrowLeft")
        page.keyboard.down("w")
        steered(host, -1, "keyboard")
        wait_until(lambda: host.control.throttle == 1)
        assert host.control.hold_mph is None  # the pedal is stronger than the speed that is held
        page.evaluate("dispatchEvent(new Event('blur'))")
        wait_until(lambda: not host.control.is_touching)
        assert (host.control.steering, host.control.throttle) == (0, 0)
        number = host.control.number
        page.keyboard.down("ArrowLeft")  # it is still held: the system repeats it
        wait_until(lambda: host.control.number > number + 3)
        assert host.control.steering == 0
        page.keyboard.up("ArrowLeft")
        page.keyboard.up("w")
        page.keyboard.down("d")
        steered(host, 1, "keyboard")
        wait_until(lambda: page.inner_text("#sent") == "1.00 right")
        wait_until(lambda: page.inner_text("#delay") != "-")
        page.keyboard.up("d")
        steered(host, 0, "keyboard")


def test_the_mouse_steers_by_its_way_from_where_the_button_went_down(
    browser: Browser, bench: Served, host: Host
) -> None:
    with at_wheel(browser, bench, host) as page:
        page.mouse.move(500, 300)
        page.mouse.down()
        page.mouse.move(585, 300)  # half of 170 pixels
        steered(host, 0.5, "mouse")
        page.keyboard.down("ArrowUp")  # drives, and does not take the steering from it
        wait_until(lambda: host.control.throttle == 1)
        assert (host.control.steering, host.control.device) == (0.5, "mouse")
        page.mouse.move(100, 790)  # beyond the picture, and beyond full lock
        steered(host, -1, "mouse")
        page.mouse.up()
        steered(host, 0, "mouse")
        page.keyboard.up("ArrowUp")


def test_a_finger_steers_and_drives(browser: Browser, bench: Served, host: Host) -> None:
    with at_wheel(browser, bench, host) as page:
        page.set_viewport_size({"width": 390, "height": 844})
        wait_until(lambda: page.evaluate("document.documentElement.scrollWidth") <= 390)
        width = page.evaluate("document.getElementById('cockpit').clientWidth")
        phone = page.context.new_cdp_session(page)

        def touch(kind: str, *points: tuple[float, float]) -> None:
            given: Any = {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]}
            phone.send("Input.dispatchTouchEvent", given)

        touch("touchStart", (200, 200))
        touch("touchMove", (200 + 0.15 * width, 200))
        wait_until(lambda: host.control.steering == pytest.approx(0.5, abs=0.02))
        assert (host.control.device, host.control.hold_mph) == ("touch", 10)
        touch("touchMove", (200, 340))  # down: it brakes
        wait_until(lambda: host.control.throttle == -1)
        touch("touchEnd")
        wait_until(lambda: not host.control.is_touching)
        assert (host.control.steering, host.control.device) == (0, "touch")
        phone.detach()


def test_the_gamepad_that_moved_last_steers_and_is_let_go_when_unplugged(
    browser: Browser, bench: Served, host: Host
) -> None:
    pads: list[dict[str, Any]] = [
        {"index": 0, "id": "Pad A", "axes": [0.04]},
        {"index": 1, "id": "Pad B", "axes": [0]},
    ]
    with at_wheel(browser, bench, host) as page:
        page.evaluate(PADS, pads)
        wait_until(lambda: page.text_content("#pads") == "Pad A · Pad B")
        pads[0]["axes"] = [1]
        page.evaluate(PADS, pads)
        steered(host, 1, "gamepad")
        pads[1].update(axes=[-1], pressed={"7": 0.5})
        page.evaluate(PADS, pads)
        steered(host, -1, "gamepad")
        assert host.control.throttle == 0.5
        page.evaluate(PADS, pads[:1])  # at full lock
        steered(host, 0, "gamepad")
        wait_until(lambda: "Pad B was unplugged" in page.inner_text("#events"))


def test_the_buttons_of_a_wheel_are_learnt_and_remembered(browser: Browser, bench: Served, host: Host) -> None:
    wheel: dict[str, Any] = {"index": 0, "id": "Wheel", "mapping": "", "axes": [0]}

    def press(button: int) -> None:
        for value in (0, 1, 0):
            page.evaluate(PADS, [wheel | {"pressed": {str(button): value}}])
            page.wait_for_timeout(200)  # a few polls

    with at_wheel(browser, bench, host) as page:
        page.click("summary:has-text('Gamepad or wheel')")
        page.wait_for_timeout(300)
        press(4)
        page.click("[data-learns=r]")
        press(4)
        assert page.inner_text("[data-learns=r] output") == "button 5"
        assert host.number_of("record") == 0
        press(4)
        wait_until(lambda: host.number_of("record") == 1)
        page.reload()
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        press(4)
        wait_until(lambda: host.number_of("pause") == 1)
        assert page.text_content("[data-learns=r] output") == "button 5"
        page.eval_on_selector("[data-learns=r]", "button => (button.click(), button.click())")  # forgets it
        assert page.text_content("[data-learns=r] output") == "as above"


def test_a_gamepad_that_hangs_aside_or_sends_noise_does_not_steer(browser: Browser, bench: Served) -> None:
    with window_of(browser, 1280, 800) as page:
        page.goto(with_token(f"{bench.address}/wheel"))
        steering, problems = page.evaluate(
            """async () => {
              const { Gamepads } = await import('STATIC/js/wheel/gamepads.js');
              const { loadSettings } = await import('STATIC/js/wheel/settings.js');
              const problems = [], steering = [];
              const poll = (pads, value, mapping = 'standard') => {
                const pad = { index: 0, id: 'a', connected: true, mapping, axes: [value], buttons: [] };
                navigator.getGamepads = () => [null, pad];
                pads.advance();
                return pads.steering;
              };
              const all = (...values) => {
                const pads = new Gamepads(loadSettings(), (text) => problems.push(text));
                steering.push(values.map((value) => poll(pads, value)).at(-1));
              };
              all(...Array(9).fill(0.3));                                    // never at rest
              all(0, 0.9);                                                   // a spike
              all(0, NaN, NaN, NaN);
              all(0, ...Array.from({ length: 40 }, (_, at) => (at % 2 ? 0.5 : -0.5)));
              all(0, 7, 7, 7);                                               // out of range
              return [steering, problems];
            }""".replace("STATIC", STATIC)
        )
    assert steering == [0, 0, 0, 0, 1]
    assert len(problems) == 1
    assert "noise" in problems[0]


def test_the_drive_goes_on_where_it_was_when_the_connection_is_cut(browser: Browser, tmp_path: Path) -> None:
    (port,) = free_ports(1)
    with (
        pytest.MonkeyPatch.context() as patch,
        driving_in(patch, tmp_path) as host,
        window_of(browser, 1280, 800) as page,
    ):
        with served(tmp_path, port=port) as bench:
            page.goto(with_token(f"{bench.address}{host.address}"))
            page.wait_for_selector("#wheel[data-holder=true][data-frame]")
            page.keyboard.press("r")
            wait_until(lambda: host.number_of("record") == 1)
            page.keyboard.down("ArrowLeft")
            steered(host, -1, "keyboard")
        wait_until(lambda: page.is_visible("#problem"))
        assert host.control.steering == 0
        frames = host.frames
        with served(tmp_path, port=port):
            wait_until(lambda: not page.is_visible("#problem"))
            wait_until(lambda: int(page.get_attribute("#wheel", "data-frame") or 0) > frames)
            wait_until(lambda: page.inner_text("#recording") == "recording")
            page.keyboard.up("ArrowLeft")
            page.keyboard.down("ArrowRight")
            steered(host, 1, "keyboard")
            page.keyboard.up("ArrowRight")


@contextlib.contextmanager
def driving_in(patch: pytest.MonkeyPatch, folder: Path) -> Iterator[Host]:
    patch.setenv("BC_CACHE", str(folder / "cache"))
    with driving_host(folder / "sessions" / "lake-1.mcap") as host:
        yield host


def test_a_second_page_watches_and_is_given_the_wheel_when_it_asks(
    browser: Browser, bench: Served, host: Host
) -> None:
    with at_wheel(browser, bench, host) as page:
        second = page.context.new_page()
        second.goto(f"{bench.address}{host.address}")
        second.wait_for_selector("#wheel[data-holder=false][data-frame]")
        assert second.is_disabled("#record")
        second.keyboard.press("t")
        wait_until(lambda: "asks for the wheel" in page.inner_text("#seat"))
        page.keyboard.press("t")
        second.wait_for_selector("#wheel[data-holder=true]")
        page.wait_for_selector("#wheel[data-holder=false]")
        second.keyboard.down("ArrowRight")
        steered(host, 1, "keyboard")
        second.close()
        steered(host, 0, "keyboard")
        wait_until(lambda: "Take the wheel" in page.inner_text("#seat"))
        page.keyboard.press("t")  # nobody has it: it is given at once
        page.wait_for_selector("#wheel[data-holder=true]")


def test_the_first_touch_takes_a_wheel_that_nobody_holds(browser: Browser, bench: Served, host: Host) -> None:
    with at_wheel(browser, bench, host) as page:
        second = page.context.new_page()
        second.goto(f"{bench.address}{host.address}")
        second.wait_for_selector("#wheel[data-holder=false][data-frame]")
        page.goto("about:blank")
        second.bring_to_front()
        wait_until(lambda: "Nobody has the wheel" in second.inner_text("#seat"))
        second.keyboard.down("ArrowLeft")
        steered(host, -1, "keyboard")
        assert second.is_hidden("#seat")


def test_a_person_takes_over_from_a_network_hands_back_and_ends_the_drive(browser: Browser, bench: Served) -> None:
    log = bench.folder / "sessions" / "lake-1.mcap"
    with driving_host(log, with_network=True) as host, at_wheel(browser, bench, host) as page:
        wait_until(lambda: page.inner_text("#driver") == "the network drives: a-run")
        assert page.inner_text("#predicted") == f"{PREDICTED:.2f} right"
        page.keyboard.press("ArrowLeft")
        wait_until(lambda: page.inner_text("#driver") == "you drive: keyboard")
        page.keyboard.press("h")
        wait_until(lambda: page.inner_text("#driver") == "the network drives: a-run")
        page.keyboard.press("x")
        wait_until(lambda: host.number_of("bad") == 1)
        page.keyboard.press("?")
        page.wait_for_selector("#help")
        page.keyboard.press("Escape")  # closes the keys alone
        page.wait_for_selector("#help", state="hidden")
        assert not page.is_visible("#confirm")
        page.keyboard.press("Escape")
        page.keyboard.press("Escape")  # go on
        page.wait_for_selector("#confirm", state="hidden")
        assert not host.is_ended
        page.keyboard.press("Escape")
        page.keyboard.press("Enter")
        wait_until(lambda: host.is_ended)
        page.wait_for_selector("#ended")
        wait_until(lambda: "Nothing was recorded." in page.inner_text("#after"))


def test_what_was_chosen_is_remembered(browser: Browser, bench: Served, host: Host) -> None:
    with at_wheel(browser, bench, host) as page:
        page.keyboard.press("p")  # the speed is not held any more
        wait_until(lambda: host.control.number and host.control.hold_mph is None)
        page.fill("#hold_mph", "20")
        page.keyboard.press("Enter")
        page.keyboard.press("Escape")  # out of the field; the drive goes on
        assert not page.is_visible("#confirm")
        page.reload()
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        assert (page.is_checked("#holds"), page.input_value("#hold_mph")) == (False, "20")
        page.keyboard.press("p")
        wait_until(lambda: host.control.hold_mph == 20)


def test_a_newcomer_drives_and_finds_the_session_and_what_to_do_next(browser: Browser, bench: Served) -> None:
    """By the real command, from the form to the buttons after the drive."""
    with opened_page(browser, f"{bench.address}/wheel") as page:
        page.fill("input[name=name]", "mine")
        page.click("button.main")
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        page.keyboard.press("r")
        page.keyboard.down("ArrowLeft")
        wait_until(lambda: int(page.inner_text("#rows").split()[0]) > 10)
        growing = wait_until(lambda: re.findall(r'href="(/sessions/mine[^"]*)"', bench.get("/sessions").text))
        assert 'class="state">recording' in bench.get("/sessions").text
        assert bench.get(growing[0]).status == 200
        page.keyboard.up("ArrowLeft")
        page.keyboard.press("Escape")
        page.keyboard.press("Enter")
        page.wait_for_selector("#after button")
        assert "Train on it" in page.inner_text("#after")
        driven = page.url
        page.reload()
        assert page.url.endswith("/wheel/after/sessions/mine")
        page.goto(driven)
        assert page.url.endswith("/wheel/after/sessions/mine")
        page.go_back()  # to the page that waited for the drive
        page.wait_for_url("**/wheel/after/sessions/mine")
    log = bench.folder / "sessions" / "mine.mcap"
    with Log(log) as opened:
        states = opened.vehicle()
        assert opened.metadata["driver"] == "human"
        assert min(states["steering"].to_pylist()) == -1
    checked = subprocess.run(command("bc-log", "check", log), env=environment(), capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_a_full_disk_ends_the_drive_on_its_page_which_names_what_is_kept(browser: Browser, bench: Served) -> None:
    with files_of_at_most(1 << 20):
        words = command("bc-record", "me", "mine", "--sessions", bench.folder / "sessions")
        process = subprocess.Popen(words, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    with contextlib.ExitStack() as stack:
        stack.callback(process.wait)
        stack.callback(process.kill)
        page = stack.enter_context(opened_page(browser, f"{bench.address}/wheel"))
        page.click("#running a")
        page.wait_for_selector("#wheel[data-holder=true][data-frame]")
        page.keyboard.press("r")
        page.wait_for_selector("#ended:visible")
        assert "File too large" in page.inner_text("#ended-title")
        page.wait_for_selector("#after .lead")
        assert "bc-log recover" in page.inner_text("#after")
        assert page.inner_text("#recording") == "ended"
