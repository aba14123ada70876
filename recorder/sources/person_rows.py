"""Renders and writes the rows of a person's drive in a thread, so that the drive does not wait for them."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable
from functools import partial
from typing import Final, Self

from recorder.bc_pb2 import VehicleState
from recorder.log.meant_gaps import MeantGap
from recorder.log.writer import EventLevel, LogWriter, pose_message
from simulator.driving.simulation import Simulation
from simulator.pose import Pose
from simulator.rendering.camera import MOUNT_LEFT_M

MAX_WAITING: Final = 10
"""The most rows that wait to be rendered; a kill loses them. Then the drive and its clock wait."""
MAX_PATIENT: Final = 5  # with fewer waiting rows, the person's pictures are rendered first
_PATIENCE_S: Final = 0.05
_TICK_S: Final = 0.1


class PersonRows:
    """Renders rows and writes them to a log in order. As a context manager, it writes all before its end."""

    def __init__(self, simulation: Simulation, writer: LogWriter, let_pass: Callable[[float], object]) -> None:
        """`let_pass` waits until nothing more urgent is rendered, at most the given seconds."""
        self._let_pass = let_pass
        self._simulation = simulation
        self._writer = writer
        self._actions: queue.Queue[Callable[[], None] | None] = queue.Queue(MAX_WAITING)
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="rows", daemon=True)
        self.count = 0  # rows until now, including waiting ones
        self.written = 0  # rows in the log
        self.last_ns = 0

    def add(self, time_ns: int, pose: Pose, state: VehicleState, gap: MeantGap | None) -> None:
        """Add a row, with the gap before it. Waits while too many rows wait. Raises errors of earlier writing."""
        self._put(partial(self._write, self.count, time_ns, pose, state, gap))
        self.count += 1
        self.last_ns = time_ns

    def event(self, text: str, level: EventLevel = "INFO") -> None:
        """Add an event at the time of the last row."""
        time_ns = self.last_ns
        if self.count:  # the times of a log begin with its rows
            self._put(lambda: self._writer.event(time_ns, text, level, "recorder"))

    def check(self) -> None:
        """Raise an error of earlier writing."""
        if self._failure is not None:
            raise self._failure

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(Exception):  # raised below
            self._put(None)
        self._thread.join()
        self.check()

    def _put(self, action: Callable[[], None] | None) -> None:
        while True:
            self.check()
            with contextlib.suppress(queue.Full):
                return self._actions.put(action, timeout=_TICK_S)

    def _write(self, number: int, time_ns: int, pose: Pose, state: VehicleState, gap: MeantGap | None) -> None:
        jpegs = {}
        for camera in MOUNT_LEFT_M:
            if self._actions.qsize() < MAX_PATIENT:
                self._let_pass(_PATIENCE_S)
            jpegs[camera] = self._simulation.jpeg(camera, pose)
        for camera, jpeg in jpegs.items():
            self._writer.picture(camera, time_ns, number, jpeg)
        self._writer.vehicle(time_ns, number, state, gap)
        self._writer.pose(time_ns, number, pose_message(pose, time_ns))
        self.written = number + 1

    def _run(self) -> None:
        try:
            while True:
                try:
                    action = self._actions.get(timeout=_TICK_S)
                except queue.Empty:
                    self._writer.flush_if_due()
                    continue
                if action is None:
                    return
                action()
        except Exception as error:
            self._failure = error
