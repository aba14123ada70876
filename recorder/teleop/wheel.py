"""The wheel of a driving process: pages connect to it, send controls, and show frames.

It serves a websocket on this machine only. bc-web has its token, and relays the messages of the pages. Each page
has two threads. The driving loop gets the newest control, hands over the newest frame, and never waits for a page.
"""

from __future__ import annotations

import contextlib
import hmac
import http
import json
import os
import secrets
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Final, Literal, NamedTuple, Self, cast

import msgspec
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response
from websockets.sync.server import ServerConnection, serve

from common import UserError
from common.locks import is_being_written, lock
from common.untrusted import read_bounded
from common.users_cache import users_cache
from recorder.teleop.seat import (
    MAX_MESSAGE_BYTES,
    AskMessage,
    BadMessage,
    Control,
    ControlMessage,
    GiveMessage,
    GotMessage,
    Seat,
    ViewMessage,
    parse_message,
)

_MAX_BYTES: Final = 1 << 16
_MAX_START_S: Final = 60.0  # an older file without a lock belongs to a process that died


class OpenWheel(msgspec.Struct, frozen=True):
    """A driving process of this user that a page can connect to, on 127.0.0.1."""

    key: str
    port: int
    token: str  # of the header `Authorization: Bearer TOKEN`
    project: str  # the folder in which the process was started
    title: str
    log: str


def open_wheels(project: Path) -> list[OpenWheel]:
    """The wheels of processes that were started in the folder `project`, newest first."""
    wheels = []
    for path in _files():
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            if is_being_written(path):
                wheel = msgspec.json.decode(read_bounded(path, _MAX_BYTES), type=OpenWheel)
                if wheel.key == path.stem and wheel.project == str(project.absolute()):
                    wheels.append(wheel)
            elif time.time() - path.stat().st_mtime > _MAX_START_S:
                path.unlink()
    return sorted(wheels, key=lambda wheel: wheel.key, reverse=True)


@contextlib.contextmanager
def announced(wheel: OpenWheel) -> Iterator[None]:
    """List a wheel until the context ends or the process dies. Without a cache folder, it is not listed."""
    path = _folder() / f"{wheel.key}.json"
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            stack.callback(path.unlink, missing_ok=True)  # after the file is closed: Windows removes no open files
            stream = stack.enter_context(os.fdopen(descriptor, "wb"))
            lock(stream)
            stream.write(msgspec.json.encode(wheel))
            stream.flush()
        yield


def _folder() -> Path:
    return users_cache() / "wheels"


def _files() -> list[Path]:
    with contextlib.suppress(OSError):
        return list(_folder().glob("*.json"))
    return []


MAX_PAGES: Final = 8
MAX_PER_S: Final = 500  # a page that sends more messages a second is disconnected; a correct one sends 60
MAX_IN_FLIGHT: Final = 2
"""Frames sent to a page and not shown yet: the page paints one while the next one travels."""
_MAX_TEXTS: Final = 256  # waiting for a page; the oldest are dropped
STALLED_S: Final = 1.0  # after this silence of the simulator, pages say so
_END_S: Final = 2.0  # the longest wait for the last messages

RequestKind = Literal["record", "pause", "bad", "hand_back", "put_back", "end"]


class Request(NamedTuple):
    """The person's request to the driving loop."""

    kind: RequestKind
    seconds: float = 0.0  # for "bad": the length of the bad driving


class _Frame(NamedTuple):
    number: int
    data: bytes


class _Page:
    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.texts: deque[str] = deque(maxlen=_MAX_TEXTS)
        self.sent = 0  # the number of the last frame
        self.in_flight: deque[int] = deque()
        self.wants_recorded = False
        self.is_over = False
        self.second, self.in_second = 0, 0  # for the rate limit


class Wheel:
    """A person at the wheel. As a context manager, it serves pages, and `open_wheels` lists it."""

    def __init__(self, title: str, log: Path, about: Mapping[str, object]) -> None:
        """`about` is the message "hello" to each page that connects."""
        self._title, self._log = title, log
        self.key = f"{time.time_ns() // 1_000_000:013d}-{secrets.token_hex(4)}"  # names sort by time
        self.control_came = threading.Event()  # set until the loop gets the newest control
        self._hello = json.dumps({"type": "hello", "title": title, "log": str(log), **about}, allow_nan=False)
        self._token = secrets.token_urlsafe(24)
        self._changed = threading.Condition()
        self._seat = Seat()
        self._pages: list[_Page] = []
        self._requests: deque[Request] = deque(maxlen=64)
        self._frame: _Frame | None = None
        self._shown: tuple[Mapping[str, object], bytes] | None = None  # what it is made of
        self._stalled = ""  # the reason on it
        self._is_over = False

    @property
    def pages(self) -> int:
        """How many pages are connected."""
        return len(self._pages)

    @property
    def wants_recorded(self) -> bool:
        """True if the page that holds the wheel wants the recorded picture."""
        holder = self._seat.holder
        return isinstance(holder, _Page) and holder.wants_recorded

    def control(self) -> Control:
        """The controls in force."""
        with self._changed:
            self.control_came.clear()
            return self._seat.control(time.monotonic())

    def wait_for_touch(self) -> None:
        """Keep the controls neutral until the person touches anew: the car is another one now."""
        with self._changed:
            self._seat.wait_for_touch()

    def requests(self) -> list[Request]:
        """The requests since the last call."""
        with self._changed:
            requests = list(self._requests)
            self._requests.clear()
        return requests

    def show(self, state: Mapping[str, object], jpeg: bytes) -> None:
        """Show a frame on all pages. It replaces an earlier frame that was not sent yet."""
        with self._changed:
            self._shown, self._stalled = (state, jpeg), ""
            self._show(state, jpeg)

    def note_silence(self, silent_s: float, *, is_connected: bool) -> None:
        """Note how long the simulator has been silent. If that is long, or if it has gone, pages get the last
        frame again, with the reason."""
        why = "gone" if not is_connected else "silent" if silent_s >= STALLED_S else ""
        with self._changed:
            if self._shown is not None and why not in ("", self._stalled):
                self._stalled = why
                state, jpeg = self._shown
                self._show({**state, "stalled": why, "stalled_since_s": time.time() - silent_s}, jpeg)

    def event(self, text: str, *, is_problem: bool = False) -> None:
        """Send a line about an event to all pages."""
        level = "warning" if is_problem else "info"
        with self._changed:
            self._to_all(json.dumps({"type": "event", "text": text, "level": level}))

    def end(self, about: Mapping[str, object]) -> None:
        """Send the last message to all pages, and serve no more."""
        with self._changed:
            if self._is_over:
                return
            self._to_all(json.dumps({"type": "ended", **about}, allow_nan=False))
            self._is_over = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._pages, _END_S)

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            serving = serve(
                self._serve,
                "127.0.0.1",
                0,
                process_request=self._check,
                compression=None,
                max_size=MAX_MESSAGE_BYTES,
                origins=[None],  # no browsers: their pages come through bc-web
                open_timeout=5,
                close_timeout=1,
                server_header=None,
            )
            server = stack.enter_context(serving)
            threading.Thread(target=server.serve_forever, name="wheel", daemon=True).start()
            port = server.socket.getsockname()[1]
            project = str(Path.cwd().absolute())
            stack.enter_context(
                announced(OpenWheel(self.key, port, self._token, project, self._title, str(self._log)))
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        reason = f": {error}" if isinstance(error, UserError) else ""
        self.end({"why": f"the drive has ended{reason}"})
        self._stack.close()

    def _check(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        given = request.headers.get("Authorization", "")
        if not hmac.compare_digest(given.encode(), f"Bearer {self._token}".encode()):
            return connection.respond(http.HTTPStatus.UNAUTHORIZED, "the token is missing\n")
        if len(self._pages) >= MAX_PAGES:
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_PAGES} pages are connected\n")
        return None

    def _serve(self, connection: ServerConnection) -> None:
        """Receive a page's messages until it disconnects."""
        page = _Page(connection)
        with self._changed:
            page.texts.append(self._hello)
            self._pages.append(page)
            self._seat.enter(page, time.monotonic())
            self._send_seats()
        sender = threading.Thread(target=self._send, args=(page,), name="wheel's page", daemon=True)
        sender.start()
        try:
            for text in connection:
                with self._changed:
                    is_good = self._receive(page, text)
                if not is_good:
                    connection.close(CloseCode.POLICY_VIOLATION, "too many messages")
                    break
        except ConnectionClosed:  # the network failed, or a message was too long
            pass
        finally:
            with self._changed:
                page.is_over = True
                self._seat.leave(page, time.monotonic())
                self._send_seats()
                self._changed.notify_all()
            sender.join()
            with self._changed:
                self._pages.remove(page)
                self._changed.notify_all()

    def _receive(self, page: _Page, text: str | bytes) -> bool:
        """Handle a page's message; False if the page is to be disconnected."""
        now_s = time.monotonic()
        if int(now_s) != page.second:
            page.second, page.in_second = int(now_s), 0
        page.in_second += 1
        if page.in_second > MAX_PER_S:
            return False
        match parse_message(text):
            case None:
                pass
            case ControlMessage() as message:
                if self._seat.steer(page, message, now_s):
                    self.control_came.set()
            case GotMessage(frame):
                while page.in_flight and page.in_flight[0] <= frame:
                    page.in_flight.popleft()
                self._changed.notify_all()
            case ViewMessage(recorded):
                page.wants_recorded = recorded
            case AskMessage():
                self._seat.ask(page, now_s)
                self._send_seats()
            case GiveMessage():
                self._seat.give(page, now_s)
                self._send_seats()
            case request:
                if page is self._seat.holder:
                    seconds = request.seconds if isinstance(request, BadMessage) else 0.0
                    kind = cast(RequestKind, request.__struct_config__.tag)
                    self._requests.append(Request(kind, seconds))
        return True

    def _send(self, page: _Page) -> None:
        """Send texts and frames to a page until it disconnects or the wheel ends."""

        def new_frame() -> _Frame | None:
            frame = self._frame
            is_new = frame is not None and frame.number > page.sent and len(page.in_flight) < MAX_IN_FLIGHT
            return frame if is_new else None

        with contextlib.suppress(ConnectionClosed):
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: page.texts or page.is_over or self._is_over or new_frame())
                    if page.is_over or (self._is_over and not page.texts):
                        break
                    texts = list(page.texts)
                    page.texts.clear()
                    if frame := new_frame():
                        page.sent = frame.number
                        page.in_flight.append(frame.number)
                for text in texts:
                    page.connection.send(text)
                if frame:
                    page.connection.send(frame.data)
        page.connection.close()

    def _send_seats(self) -> None:
        for page in self._pages:
            is_holder = page is self._seat.holder
            asked = is_holder and self._seat.asking is not None
            seat = {"type": "wheel", "holder": is_holder, "asked": asked, "free": self._seat.holder is None}
            page.texts.append(json.dumps(seat))
        self._changed.notify_all()

    def _show(self, state: Mapping[str, object], jpeg: bytes) -> None:
        number = 1 if self._frame is None else self._frame.number + 1
        head = json.dumps({"frame": number, **state}, allow_nan=False).encode()
        self._frame = _Frame(number, b"".join((struct.pack(">I", len(head)), head, jpeg)))
        self._changed.notify_all()

    def _to_all(self, text: str) -> None:
        for page in self._pages:
            page.texts.append(text)
        self._changed.notify_all()
