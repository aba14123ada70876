"""A log in Rerun inside its page: the viewer shows the page's moment; what serves the log ends with the page."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import psutil  # type: ignore[import-untyped]

from common.car import Camera
from driving import PATIENCE_S
from logs import write_log
from waiting import wait_until
from workbench import Served, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROWS = 40
RED, GREEN = (0, 0, 255), (0, 255, 0)


def first_red_then_green(camera: Camera, row: int) -> bytes:
    ok, encoded = cv2.imencode(".png", np.full((40, 80, 3), RED if row < ROWS // 2 else GREEN, np.uint8))
    assert ok
    return encoded.tobytes()


def write_colored(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    return write_log(path, [0.5 * np.sin(row) for row in range(ROWS)], first_red_then_green, cameras=["center"])


@contextlib.contextmanager
def opened(bench: Served, name: str) -> Iterator[Iterator[dict[str, Any]]]:
    """The lines that the server says of a log while it is open in Rerun: until nobody reads them."""
    connection = http.client.HTTPConnection("127.0.0.1", bench.port, timeout=PATIENCE_S)
    with contextlib.closing(connection):
        connection.request("POST", f"/sessions/{name}/rerun")
        answer = connection.getresponse()
        assert answer.status == 200, answer.read()
        with contextlib.closing(answer):
            yield (json.loads(line) for line in answer)


def data_port(bench: Served, frame: str) -> int:
    """Of the only address that the frame's page may reach beside the workbench."""
    policy = bench.get(frame).headers["content-security-policy"]
    return int(policy.partition("connect-src 'self' http://127.0.0.1:")[2].partition(";")[0])


def is_listening(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), PATIENCE_S):
        return True
    return False


def serving() -> set[str]:
    """The logs that processes of this one have open."""
    found = set()
    for process in psutil.Process().children():
        with contextlib.suppress(psutil.Error):  # it ends at this moment
            found |= {Path(word).stem for word in process.cmdline() if word.endswith(".mcap")}
    return found


def test_what_serves_a_log_ends_with_its_page_and_two_are_open_at_most(tmp_path: Path) -> None:
    logs = [write_colored(tmp_path / "sessions" / f"{name}.mcap") for name in "abc"]
    data = logs[0].read_bytes()
    logs[0].write_bytes(data[:2000] + bytes(500) + data[2500:])  # among its pictures
    with served(tmp_path) as bench, contextlib.ExitStack() as still_open:
        first = still_open.enter_context(opened(bench, "a"))
        frame = next(first)["frame"]
        port = data_port(bench, frame)
        assert is_listening(port)
        assert "WebHandle" in bench.get("/rerun/files/re_viewer.js").text
        assert "skipped pictures" in next(first)["note"]
        still_open.enter_context(opened(bench, "b"))
        with opened(bench, "c"):
            assert "2 logs were opened in Rerun since" in next(first)["problem"]
        # one made room for others, the page of another was closed
        wait_until(lambda: serving() == {"b"})
        assert not is_listening(port)
        assert bench.get(frame).status == 404
        logs[1].unlink()
        assert bench.ask("POST", "/sessions/b/rerun").status == 404
        others = still_open.pop_all()  # still open when bc-web ends
    assert serving() == set()
    others.close()


def test_only_files_of_the_viewer_are_given_out(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        assert bench.get("/rerun/files/index.html").status == 404
        assert bench.get("/rerun/files/re_viewer.js").status == 503  # nothing is open
        assert bench.get("/rerun/0123456789abcdef").status == 404
        assert bench.ask("POST", "/sessions/x/rerun", b"", Sec_Fetch_Site="cross-site").status == 403


def test_rerun_shows_the_moment_of_the_curves_inside_the_page(browser: Browser, tmp_path: Path) -> None:
    write_colored(tmp_path / "sessions" / "colored.mcap")
    with served(tmp_path) as bench:
        page = browser.new_page(viewport={"width": 800, "height": 1000})
        page.set_default_timeout(4 * PATIENCE_S * 1000)  # it draws in software
        page.goto(f"{bench.address}/sessions/colored#row=30")
        page.wait_for_selector("#session[data-ready]")
        page.keyboard.press("o")
        frame = page.locator("#rerun iframe")

        def is_seen(color: tuple[int, int, int]) -> bool:
            picture = cv2.imdecode(np.frombuffer(frame.screenshot(), np.uint8), cv2.IMREAD_COLOR)
            assert picture is not None
            return int((np.abs(picture.astype(int) - color).max(axis=2) < 40).sum()) > 5000

        page.wait_for_selector("#rerun[data-shown]")
        wait_until(lambda: is_seen(GREEN))
        assert not is_seen(RED)
        page.keyboard.press("Home")  # the keys are still the page's
        wait_until(lambda: is_seen(RED))
        page.keyboard.press("o")
        frame.wait_for(state="detached")
        page.close()
