"""What the tests of the server share: a handler that keeps a book, a server in a thread, clients of every kind."""

from __future__ import annotations

import base64
import contextlib
import functools
import json
import logging
import random
import socket
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

import cv2
import numpy as np
import socketio
import websocket

from recorder.server.telemetry import MAX_IMAGE_BYTES, TelemetryError, parse_telemetry
from recorder.server.telemetry_server import Answer, Steer, TelemetryServer
from simulator.protocol.client import ServerCommand, SimulatorClient, SimulatorMessage, SimulatorTelemetry
from tests.helpers.driving import PATIENCE_S, road_jpeg

UNUSED = Steer(0.0, -1.0)
"""What a telemetry is answered by that cannot be used."""


class Book:
    """Answers a telemetry by the steering that it tells, the other way round; writes down its calls."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.answered_ms: list[float] = []
        self.waited_ms: list[float] = []  # from the last byte to the handler's answer
        self.left: list[object] = []  # without an answer
        self.overlaps = 0
        self.ticks = 0
        self.last: Steer | None = None
        self._is_busy = threading.Lock()

    def connected(self, sid: str) -> None:
        with self._alone("connected"):
            pass

    def disconnected(self, sid: str, reason: str) -> None:
        with self._alone("disconnected"):
            pass

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        with self._alone("telemetry"):
            self.waited_ms.append((time.perf_counter() - received_s) * 1e3)
            if data is None:
                return Answer(None, self.answered)
            try:
                telemetry = parse_telemetry(data)
            except TelemetryError:
                return Answer(UNUSED, self.answered)
            return Answer(Steer(-telemetry.steering, 0.5, telemetry.decimal_separator), self.answered)

    def answered(self, total_ms: float) -> None:
        with self._alone("answered"):
            self.answered_ms.append(total_ms)

    def unanswered(self, sid: str, data: object, received_s: float) -> None:
        with self._alone("unanswered"):
            self.left.append(data)

    def first_command_sent(self, sid: str) -> None:
        with self._alone("first_command_sent"):
            pass

    def tick(self) -> None:
        with self._alone(""):
            self.ticks += 1

    def final_command(self, sid: str) -> Steer | None:
        with self._alone("final_command"):
            return self.last

    @contextlib.contextmanager
    def _alone(self, call: str) -> Iterator[None]:
        if not self._is_busy.acquire(blocking=False):
            self.overlaps += 1
            yield
            return
        if call:
            self.calls.append(call)
        time.sleep(0)  # let another thread in, if one can get in
        yield
        self._is_busy.release()


class Serving:
    """A server that runs in a thread until the context is left; what it said, and what its run raised."""

    def __init__(self, book: Any, port: int = 0, **options: Any) -> None:
        self.notices: list[str] = []
        self.error: BaseException | None = None
        self.server = TelemetryServer(book, port=port, notify=self.notices.append, **options)
        self.port = self.server.port
        self._stop = threading.Event()
        self.thread = threading.Thread(target=self._run)

    def stop(self) -> None:
        self._stop.set()
        self.join()

    def join(self) -> None:
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()

    def _run(self) -> None:
        try:
            self.server.run(self._stop.is_set)
        except BaseException as error:
            self.error = error

    def __enter__(self) -> Self:
        self.thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.stop()
        if kind is None and self.error is not None:
            raise self.error


def steering(number: int) -> float:
    """Of telemetry `number`: all differ, and each can be told in four decimals of a degree."""
    return (number % 2001 - 1000) / 1000


def tell(port: int, numbers: Sequence[int], **client: Any) -> list[ServerCommand]:
    """The real simulator's protocol: told one by one; the answers."""
    answers: list[ServerCommand] = []
    left = iter(numbers)

    def next_telemetry(answer: ServerCommand) -> SimulatorMessage:
        if answer is not None:
            answers.append(answer)
        number = next(left, None)
        if number is not None:
            return SimulatorTelemetry(steering(number), 0.25, 9.0, PICTURES[number % len(PICTURES)])
        return None if len(answers) == len(numbers) else "nothing"

    SimulatorClient(port=port, wait_s=PATIENCE_S, **client).run(next_telemetry)
    return answers


PICTURES = [road_jpeg(number) for number in range(20)]


def fields(number: int, **changed: Any) -> dict[str, Any]:
    """Telemetry `number` as JSON; ... leaves a field out."""
    values = {
        "steering_angle": f"{steering(number) * 25:.4f}",
        "throttle": "0.2500",
        "speed": "9.0000",
        "image": base64.b64encode(PICTURES[number % len(PICTURES)]).decode(),
    }
    return {name: value for name, value in {**values, **changed}.items() if value is not ...}


class ModernClient:
    """python-socketio's own client, over a websocket; `answers` holds each event and its data as they come."""

    def __init__(self, port: int) -> None:
        self.answers: list[tuple[str, Any]] = []
        self._came = threading.Condition()
        quiet = logging.getLogger("modern clients")
        quiet.disabled = True  # a thread that is left complains later, into another test's stderr
        self.client = socketio.Client(reconnection=False, engineio_logger=quiet, request_timeout=PATIENCE_S)
        self.client.on("manual", lambda data: self._note("manual", data))
        self.client.on("steer", lambda data: self._note("steer", data))
        self.client.connect(f"http://127.0.0.1:{port}", transports=["websocket"], wait_timeout=PATIENCE_S)

    def tell(self, data: object) -> tuple[str, Any]:
        """Send one telemetry and wait for its answer."""
        with self._came:
            expected = len(self.answers) + 1
            self.client.emit("telemetry", data)
            assert self._came.wait_for(lambda: len(self.answers) >= expected, PATIENCE_S), "not answered"
            return self.answers[-1]

    def wait_for(self, answers: int) -> None:
        """Wait until so many have come, asked for or not."""
        with self._came:
            assert self._came.wait_for(lambda: len(self.answers) >= answers, PATIENCE_S), "not answered"

    def close(self) -> None:
        """Hang up. Its threads are not waited for: where the server closes at the same moment, the one that writes
        waits for 30 s more. So its socket is closed here."""
        connection = self.client.eio.ws
        self.client.disconnect()
        if connection is not None:
            connection.shutdown()

    def _note(self, name: str, data: object) -> None:
        with self._came:
            self.answers.append((name, data))
            self._came.notify_all()


class RawClient:
    """A websocket that sends what it likes."""

    def __init__(self, port: int, *hello: str, path: str = "/socket.io/?EIO=4&transport=websocket") -> None:
        self.stream = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self.websocket = websocket.create_connection(f"ws://127.0.0.1:{port}{path}", socket=self.stream)
        for text in hello:
            self.websocket.send(text)

    def tell(self, data: object) -> None:
        self.websocket.send('42["telemetry",' + json.dumps(data) + "]")

    def command(self) -> tuple[str, Any]:
        """The next one; what greets modern clients and keeps their connections alive is passed over."""
        while True:
            message = str(self.websocket.recv())
            assert message, "the server has hung up"
            if message.startswith("42"):
                name, data = json.loads(message[2:])
                return name, data

    def until_hung_up(self) -> None:
        with contextlib.suppress(websocket.WebSocketConnectionClosedException, ConnectionError):
            while self.websocket.recv():
                pass
        self.stream.close()

    def close(self) -> None:
        self.websocket.send("1")
        self.websocket.close()
        self.stream.close()

    def vanish(self) -> None:
        self.stream.close()


class PollingClient:
    """A modern client that has no websocket, or not yet: python-socketio's own needs a package more for it."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.path = "/socket.io/?EIO=4&transport=polling"
        self.path += "&sid=" + json.loads(self.request()[1:])["sid"]
        self.request("40")
        while not self.request().startswith("40"):
            pass

    def request(self, message: str | None = None) -> str:
        data = None if message is None else message.encode()
        url = f"http://127.0.0.1:{self.port}{self.path}"
        with urllib.request.urlopen(url, data, timeout=PATIENCE_S) as answer:
            text: str = answer.read().decode()
            return text

    def tell(self, data: object) -> tuple[str, Any]:
        self.request(f'42["telemetry",{json.dumps(data)}]')
        name, command = json.loads(self.request()[2:])
        return name, command

    def upgraded(self) -> RawClient:
        client = RawClient(self.port, "2probe", path=self.path.replace("polling", "websocket"))
        assert client.websocket.recv() == "3probe"
        client.websocket.send("5")
        return client


def steered(steer: Steer) -> tuple[str, dict[str, str]]:
    return "steer", {"steering_angle": f"{steer.steering:.6f}", "throttle": f"{steer.throttle:.6f}"}


def jpeg(width: int, height: int) -> str:
    ok, encoded = cv2.imencode(".jpg", np.full((height, width, 3), 90, np.uint8))
    assert ok
    return base64.b64encode(encoded.tobytes()).decode()


WRONG_SIZES = [jpeg(1, 1), jpeg(321, 160), jpeg(64, 1000)]
TOO_LARGE = "A" * (MAX_IMAGE_BYTES + 4)
NUMBERS = ["nan", "inf", "-1e999", "", " ", "fast", "1.2.3", "9" * 70, "\u0661", True, [], {}, None, ...]


def malformed(chance: random.Random) -> str:
    """The text of a telemetry with something wrong: nearly anything."""
    number = chance.randrange(2001)
    text = functools.partial(json.dumps, separators=(",", ":"))
    cut = fields(number)["image"]
    kinds: list[Callable[[], str]] = [
        lambda: text(chance.choice([0, -1.5, True, [], {}, "", "steer", [fields(0)], {"telemetry": fields(0)}])),
        lambda: text(
            fields(number, **{chance.choice(["steering_angle", "throttle", "speed"]): chance.choice(NUMBERS)})
        ),
        lambda: text(fields(number, image=chance.choice([1, None, [], {}, True, "", "%%%", "é", "\ud800", ...]))),
        lambda: text(fields(number, image=cut[: chance.randrange(len(cut))])),
        lambda: text(fields(number, image=chance.choice(WRONG_SIZES))),
        lambda: text(fields(number, steering_angle=1e3, throttle=7, speed=-3.5)),
        lambda: text(fields(number, speed=chance.choice([float("nan"), float("inf"), -float("inf")]))),
        lambda: text(fields(number, speed=10 ** chance.choice([20, 90, 150, 400]))).replace("0" * 400, "0" * 5000),
        lambda: "[" * (depth := chance.choice([3, 90, 900, 5000])) + "]" * depth,
        lambda: '{"image":' * (depth := chance.choice([3, 90, 900, 5000])) + "1" + "}" * depth,
        lambda: text(fields(number))[: chance.randrange(200)],
        lambda: chance.choice(["nul", "{", "'x'", "0x1", "{]", "\x00", '"\\x"', "1 2", "NaN,", "-", "\u2028"]),
        lambda: "".join(chr(chance.randrange(32, 0x3000)) for _ in range(chance.randrange(40))),
        lambda: text(fields(number, **{f"x{i}": "y" * chance.randrange(999) for i in range(30)}, speed=...)),
        lambda: text(fields(number, world=chance.choice([1, [], {"time_s": 1}]), throttle="")),
    ]
    if chance.random() < 0.002:
        return text(fields(number, image=TOO_LARGE, **{"note": "z" * chance.randrange(MAX_IMAGE_BYTES)}))
    return chance.choice(kinds)()
