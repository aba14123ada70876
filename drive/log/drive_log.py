"""The log of a drive: all answered telemetry messages, the answers, and the events.

A thread writes it, so that the driving loop never waits for the disk.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Final

import cv2

from common import UserError
from common.closeable import Closeable
from recorder import LogWriter
from recorder.bc_pb2 import PilotCommand
from recorder.log.log_time import LogClock
from recorder.log.meant_gaps import DISCONNECTED, HUMAN_DRIVES, PILOT_DRIVES_AGAIN, BadTelemetry, HumanDriving
from recorder.log.writer import EventLevel
from recorder.server.telemetry import Telemetry, write_telemetry

if TYPE_CHECKING:
    from drive.control.driver import Decision  # loads PyTorch


MAX_PICTURE_BYTES: Final = 128 << 20
"""Maximum bytes of pictures in the queue: 35 s of driving at 60 frames a second, each with a JPEG of 15 KB and a
crop of 48 KB."""
MAX_WAITING: Final = 36_000
"""Maximum rows and events in the queue: ten minutes of driving at 60 frames a second, 100 MB without pictures."""

_IDLE_S: Final = 0.1


class LogThread:
    """Calls the functions given to `put`, in order, on its own thread, and `flush` while it is idle.

    The thread has the same priority as the driving loop: if it slept while it holds Python's lock, it would stop
    the loop.

    Two threads must not call it at once.
    """

    def __init__(self, flush: Callable[[], None]) -> None:
        self.failure: UserError | None = None
        self._bug: Exception | None = None
        self._flush = flush
        self._queue: SimpleQueue[tuple[Callable[[], None], int] | None] = SimpleQueue()
        # only one thread writes each of these, so they need no lock
        self._put_count = self._put_bytes = 0
        self._done_count = self._done_bytes = 0
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    @property
    def has_room(self) -> bool:
        return self._put_count - self._done_count < MAX_WAITING

    def has_room_for(self, picture_bytes: int) -> bool:
        return self._put_bytes - self._done_bytes + picture_bytes <= MAX_PICTURE_BYTES

    def put(self, write: Callable[[], None], picture_bytes: int = 0) -> None:
        """Queue a call of `write`. After a failure, nothing is called any more. Raises an unexpected error of an
        earlier call."""
        if self._bug is not None:
            raise self._bug
        if self.failure is None:
            self._put_count += 1
            self._put_bytes += picture_bytes
            self._queue.put((write, picture_bytes))

    def close(self) -> None:
        """Wait until everything is written. Raises an unexpected error of a call."""
        self._queue.put(None)
        self._thread.join()
        if self._bug is not None:
            raise self._bug

    def _run(self) -> None:
        while True:
            try:
                item = self._queue.get(timeout=_IDLE_S)
            except Empty:
                self._call(self._flush)
                continue
            if item is None:
                return
            write, picture_bytes = item
            self._call(write)
            self._done_bytes += picture_bytes
            self._done_count += 1

    def _call(self, write: Callable[[], None]) -> None:
        if self.failure is not None or self._bug is not None:
            return
        try:
            write()
        except UserError as error:
            self.failure = error
        except Exception as error:
            self._bug = error


_DRIVERS: Final = {
    "pilot": PilotCommand.PILOT,
    "human": PilotCommand.HUMAN,
    "expert": PilotCommand.EXPERT,
    "brake": PilotCommand.BRAKE,
}
_PNG: Final = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP)
"""A tenth smaller than with OpenCV's default filter, in the same time."""
_PICTURES_OF_A_ROW: Final = 2  # the centre camera's and the crop


class DriveLog(Closeable):
    """Writes decisions in rows that are numbered from 0. All methods except `close` return at once.

    If the disk is too slow, rows first lose their pictures; after many minutes, rows are lost, too. Both are
    counted, and events report them. A decision is written later, so it must not change any more.

    Two threads must not call it at once. Until it is closed, no other code may use the writer.
    """

    def __init__(self, writer: LogWriter) -> None:
        self.frames = 0  # rows that are, or will be, in the log
        self.dropped_pictures = 0  # camera pictures and crops that are not in the log
        self.dropped_rows = 0  # rows and events that are not in the log
        self._writer = writer
        self._clock = LogClock()
        self._thread = LogThread(writer.flush_if_due)
        self._is_manual = False
        self._human_driving = HumanDriving()
        self._is_closed = False
        self._bad = BadTelemetry()

    @property
    def failure(self) -> UserError | None:
        """The error after which nothing more is written to the log; None without an error."""
        return self._thread.failure

    def decision(self, decision: Decision, total_ms: float) -> None:
        """Write a telemetry message that was answered after `total_ms`. An unusable message becomes an event."""
        if self.failure is not None:
            return
        received_ns = _ago_ns(total_ms)
        if decision.telemetry is None:
            if (text := self._bad.take(decision.kind, decision.problem)) is not None:
                self._event(received_ns, text, is_problem=True)
        else:
            self._row(received_ns, decision, decision.telemetry, total_ms)
            for problem in decision.telemetry.side_problems:
                if (text := self._bad.take(problem, problem)) is not None:
                    self._event(received_ns, text, is_problem=True)
        for text in decision.events:
            self._event(received_ns, text, is_problem=bool(decision.problem))

    def manual(self, total_ms: float) -> None:
        """Write that a human drives. The message has no picture and no steering, so it becomes no row: events mark
        the begin of a human's driving, and of the pilot's."""
        if not self._is_manual:
            self._is_manual = True
            self._human_driving.begin(self._event(_ago_ns(total_ms), HUMAN_DRIVES))

    def disconnected(self, reason: str) -> None:
        self._is_manual = False
        self._human_driving.end(self._event(time.perf_counter_ns(), f"{DISCONNECTED}{reason}"))

    def event(self, text: str, is_problem: bool = False) -> None:
        self._event(time.perf_counter_ns(), text, is_problem)

    def close(self) -> None:
        """Wait until everything is written. Then other code may use the writer again."""
        if self._is_closed:
            return
        self._is_closed = True
        for text in self._bad.remaining():
            self._problem(text)
        for count, items in ((self.dropped_pictures, "pictures"), (self.dropped_rows, "rows and events")):
            if count:
                self._problem(f"the disk was too slow: {count:,} {items} are missing")
        self._thread.close()

    def _row(self, received_ns: int, decision: Decision, telemetry: Telemetry, total_ms: float) -> None:
        if not self._thread.has_room:
            if not self.dropped_rows:
                self._problem("the disk is too slow: rows are left out until it has caught up")
            self.dropped_rows += 1
            return
        time_ns = self._clock.row(received_ns, None if telemetry.world is None else telemetry.world.time_s)
        size = len(telemetry.picture) + sum(map(len, telemetry.side_pictures.values()))
        size += 0 if decision.crop is None else decision.crop.nbytes
        if not self._thread.has_room_for(size):
            if not self.dropped_pictures:
                self._problem("the disk is too slow: pictures are left out until it has caught up")
            self.dropped_pictures += _PICTURES_OF_A_ROW + len(telemetry.side_pictures)
            size, telemetry = 0, replace(telemetry, picture=b"", side_pictures={})
            decision = replace(decision, telemetry=telemetry, crop=None)
        if self._is_manual:
            self._human_driving.end(time_ns)
        left_out_s = self._human_driving.take_s()
        write = partial(self._write_row, time_ns, self.frames, decision, telemetry, total_ms, left_out_s)
        self._thread.put(write, size)
        self.frames += 1
        if self._is_manual:
            self._is_manual = False
            self._thread.put(partial(self._writer.event, time_ns, PILOT_DRIVES_AGAIN, "INFO", "drive"))

    def _event(self, happened_ns: int, text: str, is_problem: bool = False) -> int:
        """Write an event, if the queue has room. Returns its log time."""
        time_ns = self._clock.event(happened_ns)
        if self._thread.has_room:
            level: EventLevel = "WARNING" if is_problem else "INFO"
            self._thread.put(partial(self._writer.event, time_ns, text, level, "drive"))
        else:
            self.dropped_rows += 1
        return time_ns

    def _problem(self, text: str) -> None:
        """Write an event even if the queue is full: problems are rare."""
        time_ns = self._clock.event(time.perf_counter_ns())
        self._thread.put(partial(self._writer.event, time_ns, text, "WARNING", "drive"))

    # On the thread

    def _write_row(
        self, time_ns: int, row: int, decision: Decision, telemetry: Telemetry, total_ms: float, left_out_s: float
    ) -> None:
        crop = None
        if decision.crop is not None:
            ok, png = cv2.imencode(".png", decision.crop, _PNG)
            if not ok:  # cannot happen with these crops, but a lost crop must not go unnoticed
                raise RuntimeError("OpenCV could not write a PNG of the crop")
            crop = png.tobytes()
        write_telemetry(
            self._writer,
            time_ns,
            row,
            telemetry,
            decision.device,
            not_recorded_s=left_out_s,
            picture_size=decision.picture_size,
            crop=crop,
        )
        if not decision.is_answered:
            return
        command = PilotCommand(
            predicted_steering=decision.predicted_steering,
            steering=decision.steering,
            throttle=decision.throttle,
            driver=_DRIVERS[decision.driver],
            set_speed_mph=decision.set_speed_mph,
            parse_ms=decision.parse_ms,
            decode_ms=decision.decode_ms,
            network_ms=decision.network_ms,
            total_ms=total_ms,
            in_flight=decision.in_flight,
        )
        if decision.predicted_speed_mph is not None:
            command.predicted_speed_mph = decision.predicted_speed_mph
        if decision.predicted_throttle is not None:
            command.predicted_throttle = decision.predicted_throttle
        if telemetry.world is not None and telemetry.world.expert_steering is not None:
            command.expert_steering = telemetry.world.expert_steering
        self._writer.command(time_ns, row, command)


def _ago_ns(ms: float) -> int:
    return time.perf_counter_ns() - round(ms * 1e6)
