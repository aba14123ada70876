"""A driving process in a thread of the test: a real wheel, the built-in simulator and its pictures, and no log."""

from __future__ import annotations

import contextlib
import functools
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from recorder.teleop.frame_state import hello
from recorder.teleop.seat import Control
from recorder.teleop.wheel import Request, Wheel
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import STEP_S

RATE_HZ: Final = 10
PICTURE_STEPS: Final = 3
PREDICTED: Final = 0.25
"""The steering of the network that drives until the person touches a control."""


class Host:
    """What the driving loop got from the pages."""

    def __init__(self, wheel: Wheel, log: Path) -> None:
        self.wheel = wheel
        self.log = log
        self.controls: list[Control] = []  # each once, by its number
        self.requests: list[Request] = []
        self.is_ended = False
        self.frames = 0
        self.is_silent = False  # sends no frames

    @property
    def address(self) -> str:
        return f"/wheel/{self.wheel.key}"

    @property
    def control(self) -> Control:
        return self.wheel.control()

    def number_of(self, kind: str) -> int:
        return sum(request.kind == kind for request in self.requests)


@contextlib.contextmanager
def driving_host(log: Path, *, with_network: bool = False) -> Iterator[Host]:
    """A drive that can be found and steered until the context is left, or a page ends it."""
    simulation = _simulation()
    simulation.course.start()
    about = hello(
        "drive" if with_network else "record",
        log,
        track=simulation.track,
        run="a-run" if with_network else None,
        rate_hz=RATE_HZ,
        picture_hz=1 / (PICTURE_STEPS * STEP_S),
    )
    stopped = threading.Event()
    with Wheel(f"lake, {'a-run and me' if with_network else 'me'}", log, about) as wheel:
        host = Host(wheel, log)
        loop = threading.Thread(target=_loop, args=(host, simulation, with_network, stopped), name="host")
        loop.start()
        try:
            yield host
        finally:
            stopped.set()
            loop.join()


def _loop(host: Host, simulation: Simulation, with_network: bool, stopped: threading.Event) -> None:
    course, wheel = simulation.course, host.wheel
    is_recording = False
    is_human = not with_network
    rows = takeovers = put_back = 0
    began_s = time.monotonic()
    step = 0
    while not stopped.is_set():
        control = wheel.control()
        if control.number and (not host.controls or host.controls[-1].number != control.number):
            host.controls.append(control)
        for request in wheel.requests():
            host.requests.append(request)
            if request.kind in ("record", "pause"):
                is_recording = request.kind == "record"
                wheel.event("recording" if is_recording else "paused")
            elif request.kind == "hand_back":
                is_human = not with_network
            elif request.kind == "put_back":
                course.intervene()
                put_back += 1
            elif request.kind == "end":
                wheel.end({"log": str(host.log), "rows": rows, "why": "it was ended", "takeovers": []})
                host.is_ended = True
                return
        if control.is_touching and not is_human:
            is_human = True
            takeovers += 1
        if course.off_road:
            course.intervene()
            put_back += 1
            wheel.event("off the road: the car was put back", is_problem=True)
        speed_mph = course.vehicle.speed_mps / 0.44704
        steering = control.steering if is_human else PREDICTED
        throttle = control.throttle
        if control.is_absent and is_human:
            throttle = -1.0 if speed_mph > 0.1 else 0.0
        elif control.hold_mph is not None or not is_human:
            throttle = float(np.clip(0.3 * ((control.hold_mph or 10.0) - speed_mph), -1, 1))
        course.advance(steering, throttle)
        step += 1
        rows += is_recording and step % (50 // RATE_HZ) == 0
        if step % PICTURE_STEPS == 0 and not host.is_silent:
            state: dict[str, Any] = {
                "time_s": course.time_s,
                "control": control.number,
                "control_time_ms": control.time_ms,
                "drives": ("brake" if control.is_absent else "human") if is_human else "pilot",
                "device": control.device,
                "steering": steering,
                "predicted": PREDICTED if with_network else None,
                "throttle": throttle,
                "speed_mph": speed_mph,
                "rows": rows,
                "recorded_s": rows / RATE_HZ,
                "is_recording": is_recording,
                "pace": min(1.0, step * STEP_S / (time.monotonic() - began_s)),
                "picture_hz": step / PICTURE_STEPS / (time.monotonic() - began_s),
                "x": course.vehicle.x_m,
                "y": course.vehicle.y_m,
                "heading_rad": course.vehicle.heading_rad,
                "laps": course.progress_m / course.line.length_m,
                "takeovers": takeovers,
                "put_back": put_back,
            }
            wheel.show(state, simulation.jpeg())
            host.frames += 1
        stopped.wait(max(0.0, began_s + step * STEP_S - time.monotonic()))


@functools.cache
def _simulation() -> Simulation:
    """Its world takes a second to build."""
    return Simulation("lake")
