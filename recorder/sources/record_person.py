"""Records a person who drives the built-in simulator in real time, with a page's controls. A thread renders and
writes the rows, so that the drive does not wait."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final, Self

import cv2

from common import Skipped
from common.errors import counted
from common.files import refuse_existing
from common.interrupts import StopEvent, stop_signals
from common.process_settings import prepare_to_drive
from common.progress import StatusLine
from common.streams import never_wait
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError
from recorder.log.meant_gaps import MeantGap
from recorder.log.writer import EventLevel, LogWriter, close_with_tags, pose_message
from recorder.sources.built_in_simulator import simulation_on, simulator_metadata
from recorder.sources.eye_pictures import EYE_HZ, EyeMoment, EyePictures, WhenDue
from recorder.sources.imported_rows import Imported
from recorder.sources.settings import PersonDrive, is_row_step
from recorder.teleop.cockpit import Cockpit
from recorder.teleop.frame_state import FrameState, RateMeter, drives_alone, hello
from recorder.teleop.pedals import STANDING_MPH, CoursePedals
from recorder.teleop.seat import Control
from recorder.teleop.wheel import Request, Wheel
from recorder.topics import PERSON_METADATA, device_value
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import STEP_S
from simulator.pose import Pose
from simulator.rendering.camera import MOUNT_LEFT_M

PUT_BACK_S: Final = 1.5
"""The log's clock jumps by this time when the car is put back. After this gap, another drive begins."""
STUCK_S: Final = 5.0  # a car that does not move for this time, in spite of its throttle, is put back
_STATUS_STEPS: Final = 25
_WAIT_S: Final = 0.1  # for a picture, between two checks for signals


def record_person(
    drive: PersonDrive,
    log: Path,
    *,
    overwrite: bool = False,
    simulation: Simulation | None = None,
    on_wheel: Callable[[Wheel], object] | None = None,
) -> Imported:
    """Record a person's drive to `log`, until the page, Ctrl-C or `laps` ends it.

    `drive`: its speed is the one that the page offers to hold; without `laps`, the drive has no end.
    `simulation`: one of the same track. `on_wheel` gets the wheel as soon as pages can connect.
    Raises RecordingError for an unknown track, or if no row was recorded. Raises UserError if `log` exists and
    `overwrite` is off, or if the disk fails; the recorded rows are kept.
    """
    refuse_existing(log, overwrite)
    cv2.setNumThreads(1)  # rows and the person's pictures have a thread each
    simulation = simulation or simulation_on(drive.track)
    metadata = simulator_metadata(simulation, "human", rate=f"{drive.rate:g}")
    never_wait()
    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        about = hello(
            "record", log, track=simulation.track, rate_hz=drive.rate, picture_hz=EYE_HZ, hold_mph=drive.speed
        )
        wheel = stack.enter_context(Wheel(f"{log.stem} on {drive.track}", log, about))
        writer = stack.enter_context(LogWriter(log, metadata, overwrite=overwrite, live=True))
        if on_wheel is not None:
            on_wheel(wheel)
        prepare_to_drive()
        with (
            StatusLine() as status,
            EyePictures(simulation, wheel) as eye,
            PersonRows(simulation, writer, eye.let_pass) as rows,
        ):
            driving = _Drive(drive, simulation, wheel, rows, eye, status)
            driving.run(stopped)
        if not rows.count:
            writer.discard()
            wheel.end({"log": str(log), "rows": 0, "why": f"{driving.why}: nothing was recorded", "takeovers": []})
            raise RecordingError(f"{log}: nothing was recorded: begin to record on the page, and drive")
        writer.add_metadata(PERSON_METADATA, {"hold_mph": f"{driving.hold_mph:g}"})
        close_with_tags(writer, driving.recording.tags)
        wheel.end({"log": str(log), "rows": rows.count, "why": driving.why, "takeovers": []})
    return Imported(log, rows.count, rows.count * len(MOUNT_LEFT_M), Skipped(), writer.notices)


class _Drive(Cockpit):
    """A person's drive: the simulated clock, the car, and the recording."""

    def __init__(
        self,
        drive: PersonDrive,
        simulation: Simulation,
        wheel: Wheel,
        rows: PersonRows,
        eye: EyePictures,
        status: StatusLine,
    ) -> None:
        super().__init__(wheel, drive.speed)
        self._drive = drive
        self._course = simulation.course
        self._course.start(drive.start)
        self._rows = rows
        self._eye = eye
        self._status = status
        self._pedals = CoursePedals(simulation.course)
        self._real_time = RealTime(STEP_S)
        self._when_due = WhenDue()
        self._begin_ns = time.time_ns()
        self._step = 0
        self._shift_s = 0.0  # of the log's clock: the gaps after the car was put back
        self._stuck_steps = 0
        self._put_back = 0

    def run(self, stopped: StopEvent) -> None:
        """Drive until the person, a signal or the laps end it."""
        while not stopped.is_set():
            for text in self.attend():
                self._rows.event(text)
            if self.is_ended:
                return
            self._advance()
            if self._drive.laps is not None and self._course.laps >= self._drive.laps:
                self.why = f"{self._drive.laps:g} laps are driven"
                return
            self._rows.check()
            while not self._eye.keeps_up(self._step, _WAIT_S) and not stopped.is_set():
                pass
            self._real_time.wait(self.wheel.control_came)

    def handle(self, request: Request) -> list[str]:
        if request.kind == "put_back":
            self._put_on_line("the person had the car put back on its line")
        return super().handle(request)

    def _advance(self) -> None:
        control = self.take_control()
        steering = 0.0 if control.is_absent else control.steering
        throttle = self._pedals.throttle(control)
        self._course.advance(steering, throttle)
        self._step += 1
        if is_row_step(self._step, self._drive.rate) and self.recording.takes_row(control):
            self._record(control, throttle)
        if self._when_due.is_due(self._step, steering):
            self._eye.offer(EyeMoment(self._step, self._course.pose, self._state(control, steering, throttle)))
        if self._step % _STATUS_STEPS == 0:
            recording = "recording" if self.recording.is_on else "not recording"
            self._status.show(
                f"{recording}: {counted(self._rows.count, 'row')}, {self._course.laps:.2f} laps,"
                f" {self._real_time.pace:.0%} of real time"
            )
        self._watch(0.0 if control.is_absent else throttle)

    def _watch(self, throttle: float) -> None:
        """Put the car back if it left the road, or does not move in spite of its throttle."""
        is_still = throttle > 0 and abs(self._course.vehicle.speed_mph) < STANDING_MPH
        self._stuck_steps = self._stuck_steps + 1 if is_still else 0
        if self._course.off_road:
            self._put_on_line("the car left the road and was put back on its line")
        elif self._stuck_steps * STEP_S >= STUCK_S:
            self._put_on_line("the car was stuck and was put back on its line")

    def _put_on_line(self, why: str) -> None:
        self._course.intervene()
        self._shift_s += PUT_BACK_S
        self._stuck_steps = 0
        self._put_back += 1
        self.recording.gap_why = why
        self.wheel.event(why, is_problem=True)

    @property
    def _time_ns(self) -> int:
        return self._begin_ns + round((self._course.time_s + self._shift_s) * 1e9)

    def _record(self, control: Control, throttle: float) -> None:
        time_ns = self._time_ns
        gap_s = (time_ns - self._rows.last_ns) / 1e9 - 1 / self._drive.rate if self._rows.count else 0.0
        state = VehicleState(
            steering=control.steering,
            throttle=max(0.0, throttle),
            brake=max(0.0, -throttle),
            speed_mph=self._course.vehicle.speed_mph,
            device=device_value(control.device),
        )
        is_gap = gap_s > 0.5 / self._drive.rate and self.recording.gap_why  # more than an uneven step
        gap = MeantGap(gap_s, self.recording.gap_why) if is_gap else None
        self.recording.add(round(self._course.time_s * 1e9), self._rows.count)
        self._rows.add(time_ns, self._course.pose, state, gap)

    def _state(self, control: Control, steering: float, throttle: float) -> FrameState:
        car = self._course.vehicle
        return FrameState(
            time_s=self._course.time_s,
            control=control,
            drives=drives_alone(control, is_rolling=abs(car.speed_mph) > STANDING_MPH),
            device=control.device,
            steering=steering,
            throttle=throttle,
            speed_mph=car.speed_mph,
            rows=self._rows.written,
            recorded_s=self._rows.count / self._drive.rate,
            is_recording=self.recording.is_on,
            pace=self._real_time.pace,
            place=car,
            laps=self._course.laps,
            put_back=self._put_back,
        )


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


MAX_CATCH_UP_S: Final = 0.1  # a later clock does not catch up: the drive was in slow motion


class RealTime:
    """Paces the steps of a simulated clock, each `step_s` long."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._due_s = time.monotonic()
        self._steps = 0
        self._rates = RateMeter()

    def wait(self, sooner: threading.Event) -> None:
        """Wait until the next step is due. `sooner` begins it early, by at most a step's length."""
        self._due_s += self._step_s
        late_s = time.monotonic() - self._due_s
        if late_s < 0:
            time.sleep(max(0.0, -late_s - self._step_s))  # the previous step was early
            if not sooner.wait(max(0.0, self._due_s - time.monotonic())):
                time.sleep(max(0.0, self._due_s - time.monotonic()))
        elif late_s > MAX_CATCH_UP_S:
            self._due_s += late_s
        self._steps += 1
        self._rates.add(time.monotonic(), self._steps * self._step_s)

    @property
    def pace(self) -> float:
        """Simulated seconds per second, recently; 1 is real time."""
        pace = self._rates.pace
        return 1.0 if pace is None else min(1.0, pace)
