"""A log in Rerun inside its page: the viewer shows the page's moment; what serves the log ends with the page."""

from __future__ import annotations

import contextlib
import itertools
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from common.car import Camera
from recorder import LogWriter
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.pages import heard, window_of, with_token
from tests.helpers.rrd import contents
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Frame

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
    with bench.asked("POST", f"/sessions/{name}/rerun") as answer:
        assert answer.status == 200, answer.read()
        yield (json.loads(line) for line in answer)


def kept() -> int:
    """How many recording files lie in this test's folder for temporary files."""
    return len(list(Path(tempfile.gettempdir()).glob("bc-web-*/recording/*.rrd")))


@pytest.fixture(autouse=True)
def _own_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))


def test_what_serves_a_log_ends_with_its_page(tmp_path: Path) -> None:
    logs = [write_colored(tmp_path / "sessions" / f"{name}.mcap") for name in "ab"]
    data = logs[0].read_bytes()
    logs[0].write_bytes(data[:2000] + bytes(500) + data[2500:])  # among its pictures
    with served(tmp_path) as bench, contextlib.ExitStack() as still_open:
        with opened(bench, "a") as lines:
            printed = next(lines) | next(lines)  # in either order
            frame = printed["frame"]
            assert "connect-src 'self';" in bench.get(frame).headers["content-security-policy"]
            assert bench.get(f"{frame}/log.rrd").body[:3] == b"RRF"
            assert "WebHandle" in bench.get("/rerun/files/re_viewer.js").text
            assert "skipped pictures" in printed["note"]
        wait_until(lambda: kept() == 0)
        next(still_open.enter_context(opened(bench, "b")))
        assert bench.get(frame).status == bench.get(f"{frame}/log.rrd").status == 404
        logs[1].unlink()
        assert bench.ask("POST", "/sessions/b/rerun").status == 404
        others = still_open.pop_all()  # still open when bc-web ends
    assert kept() == 0
    others.close()


def test_only_files_of_the_viewer_are_given_out(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        assert bench.get("/rerun/files/index.html").status == 404
        assert bench.get("/rerun/0123456789abcdef").status == 404
        assert bench.get("/rerun/0123456789abcdef/log.rrd").status == 404
        assert bench.ask("POST", "/sessions/x/rerun", b"", Sec_Fetch_Site="cross-site").status == 403
        assert bench.get("/rerun/0123456789abcdef/log.rrd", Sec_Fetch_Site="cross-site").status == 403


def test_a_log_that_is_being_recorded_is_given_out_while_it_grows(tmp_path: Path) -> None:
    (tmp_path / "sessions").mkdir()
    log = LogWriter(tmp_path / "sessions" / "growing.mcap", {"source": "test"})
    rows = iter(range(8))

    def write_rows() -> None:
        for row in itertools.islice(rows, 4):
            log.picture("center", START_NS + row * STEP_NS, row, np.random.default_rng(row).bytes(1 << 17))

    write_rows()
    with served(tmp_path) as bench:
        (name,) = (path.name for path in (tmp_path / "sessions").iterdir())
        with opened(bench, name.removesuffix(".mcap.part")) as lines:
            printed = next(lines)
            assert printed["is_growing"]
            with bench.asked("GET", f"{printed['frame']}/log.rrd") as answer:
                data = answer.read(4 << 17)
                write_rows()
                log.close()
                data += answer.read()
    (tmp_path / "log.rrd").write_bytes(data)
    assert len(contents(tmp_path / "log.rrd")["/camera/center"]["EncodedImage:blob"]) == 8


def axe_finds(frame: Frame) -> list[str]:
    """What axe-core finds serious in Rerun's own page: around its canvas, which holds no elements."""
    from axe_playwright_python.base import AXE_SCRIPT  # slow

    frame.evaluate(AXE_SCRIPT)
    script = "async () => (await axe.run()).violations.map(each => `${each.impact} ${each.id}`)"
    violations: list[str] = frame.evaluate(script)
    return [violation for violation in violations if violation.startswith(("serious", "critical"))]


def test_rerun_shows_the_moment_of_the_curves_inside_the_page(browser: Browser, tmp_path: Path) -> None:
    """It asks nothing of another port or machine."""
    write_colored(tmp_path / "sessions" / "colored.mcap")
    asked: set[str] = set()
    wrong: list[str] = []
    with (
        served(tmp_path, "0.0.0.0") as bench,
        window_of(browser, 480, 700) as page,  # small: it draws in software
        heard(page, "request", lambda request: asked.add(urlsplit(request.url).netloc)),
        heard(page, "pageerror", lambda error: wrong.append(str(error))),
        heard(page, "console", lambda printed: wrong.append(printed.text) if printed.type == "error" else None),
    ):
        page.goto(with_token(f"{bench.address}/sessions/colored#row=30"))
        page.wait_for_selector("#session[data-ready]")
        page.keyboard.press("o")
        frame = page.locator("#rerun iframe")

        def is_seen(color: tuple[int, int, int]) -> bool:
            picture = cv2.imdecode(np.frombuffer(frame.screenshot(), np.uint8), cv2.IMREAD_COLOR)
            assert picture is not None
            return int((np.abs(picture.astype(int) - color).max(axis=2) < 40).sum()) > 1000

        page.wait_for_selector("#rerun[data-shown]")
        wait_until(lambda: is_seen(GREEN))
        assert not is_seen(RED)
        page.keyboard.press("Home")  # the keys are still the page's
        wait_until(lambda: is_seen(RED))
        assert axe_finds(page.frames[-1]) == []
        page.keyboard.press("o")
        frame.wait_for(state="detached")
        wait_until(lambda: kept() == 0)  # also of a page that stays
        assert (asked, wrong) == ({f"127.0.0.1:{bench.port}"}, [])
