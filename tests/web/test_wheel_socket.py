"""The socket of the page at the wheel: guarded as the pages are, and carried to the process that drives."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from recorder.teleop.wheel import MAX_PER_S, Wheel
from tests.helpers.waiting import PATIENCE_S, wait_until
from tests.helpers.workbench import Served, served

JPEG = b"\xff\xd8 a picture \xff\xd9"


@pytest.fixture
def wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wheel]:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    with Wheel("lake", tmp_path / "sessions" / "lake.mcap", {"kind": "record"}) as opened:
        yield opened


@pytest.fixture
def bench(tmp_path: Path, wheel: Wheel) -> Iterator[Served]:
    with served(tmp_path) as server:
        yield server


def socket(
    bench: Served, key: str, origin: str | None = "own", query: str = "", cookie: str = ""
) -> ClientConnection:
    own = f"http://127.0.0.1:{bench.port}"
    given = {"Cookie": cookie or f"bc-web-{bench.port}={bench.token}"}
    return connect(
        f"ws://127.0.0.1:{bench.port}/wheel/{key}/socket{query}",
        origin=own if origin == "own" else origin,  # type: ignore[arg-type]
        additional_headers=given,
        compression=None,
        proxy=None,
    )


def receive_to_the_end(page: ClientConnection) -> None:
    while True:
        page.recv(PATIENCE_S)


def flood(page: ClientConnection) -> None:
    for number in range(10_000):
        page.send(control(number + 1))
    receive_to_the_end(page)


def send_10_mb(page: ClientConnection) -> None:
    page.send("x" * 10_000_000)
    receive_to_the_end(page)


def control(number: int, steering: object = 0.5) -> str:
    values = {"number": number, "time_ms": 1.0, "steering": steering, "throttle": 0, "hold_mph": None}
    return json.dumps({"type": "control", **values, "device": "keyboard", "touching": True})


def test_the_end_of_the_drive_closes_the_socket(bench: Served, wheel: Wheel) -> None:
    with socket(bench, wheel.key) as page:
        wait_until(lambda: wheel.pages == 1)
        wheel.end({"why": "it was ended"})
        with pytest.raises(ConnectionClosed):
            receive_to_the_end(page)


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "null", "http://localhost:3000", "https://localhost:{port}"]
)
def test_a_page_from_elsewhere_cannot_steer(bench: Served, wheel: Wheel, origin: str | None) -> None:
    """Nor can what sends no Origin: each browser does, with a websocket."""
    with pytest.raises(InvalidStatus) as refused:
        socket(bench, wheel.key, origin and origin.format(port=bench.port))
    assert refused.value.response.status_code == 403
    assert wheel.pages == 0


def test_the_socket_needs_the_cookie_of_the_pages(bench: Served, wheel: Wheel) -> None:
    """An address stands in histories: only that of a page is exchanged for a cookie."""
    for query, cookie in (("", "a=b"), ("", f"bc-web-{bench.port}=wrong"), (f"?token={bench.token}", "a=b")):
        with pytest.raises(InvalidStatus) as refused:
            socket(bench, wheel.key, query=query, cookie=cookie)
        assert refused.value.response.status_code == 403
    assert wheel.pages == 0


def test_messages_that_are_none_do_no_harm(bench: Served, wheel: Wheel) -> None:
    bad: list[str | bytes] = [
        control(9, float("nan")),
        control(9, 1.5),
        control(9, 10**400),
        "no JSON",
        b"bytes",
        "[" * 4000,
    ]
    with socket(bench, wheel.key) as page:
        for message in bad:
            page.send(message)
        page.send(control(1, -1))
        wait_until(lambda: wheel.control().steering == -1)


def test_a_message_of_10_mb_ends_the_page_that_sends_it_and_no_other(bench: Served, wheel: Wheel) -> None:
    with socket(bench, wheel.key) as page, socket(bench, wheel.key) as other:
        with pytest.raises(ConnectionClosed):
            send_10_mb(page)
        assert json.loads(other.recv(PATIENCE_S))["type"] == "hello"
        wait_until(lambda: wheel.pages == 1)


def test_a_page_that_sends_10_000_messages_at_once_is_disconnected(bench: Served, wheel: Wheel) -> None:
    with socket(bench, wheel.key) as page:
        with pytest.raises(ConnectionClosed) as closed:
            flood(page)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
    wait_until(lambda: wheel.pages == 0)
    assert wheel.control().number <= 3 * MAX_PER_S
    assert bench.get(f"/wheel/{wheel.key}").status == 200
