"""Records a person who drives the built-in simulator in real time, with a page's controls."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

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
from recorder.log.writer import LogWriter
from recorder.rows.devices import device_value
from recorder.sources.built_in_simulator import simulation_on, simulator_metadata
from recorder.sources.eye_pictures import EYE_HZ, EyeMoment, EyePictures, WhenDue
from recorder.sources.frame_rate import is_row_step
from recorder.sources.imported_rows import Imported
from recorder.sources.person_pedals import CoursePedals
from recorder.sources.person_rows import PersonRows
from recorder.sources.real_time import RealTime
from recorder.sources.settings import PersonDrive
from recorder.teleop.frame_state import FrameState, drives_alone, hello
from recorder.teleop.recording import Recording
from recorder.teleop.seat import Control
from recorder.teleop.wheel import Wheel
from recorder.topics import PERSON_METADATA
from recorder.upkeep.derived_log import close_with_tags
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import STEP_S
from simulator.rendering.camera import MOUNT_LEFT_M

PUT_BACK_S: Final = 1.5
"""The log's clock jumps by this time when the car is put back. After this gap, another drive begins."""
STUCK_S: Final = 5.0  # a car that does not move for this time, in spite of its throttle, is put back
_STUCK_MPH: Final = 0.5
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
            why = driving.run(stopped)
        if not rows.count:
            writer.discard()
            wheel.end({"log": str(log), "rows": 0, "why": f"{why}: nothing was recorded", "takeovers": []})
            raise RecordingError(f"{log}: nothing was recorded: begin to record on the page, and drive")
        writer.add_metadata(PERSON_METADATA, {"hold_mph": f"{driving.hold_mph:g}"})
        close_with_tags(writer, driving.recording.tags)
        wheel.end({"log": str(log), "rows": rows.count, "why": why, "takeovers": []})
    return Imported(log, rows.count, rows.count * len(MOUNT_LEFT_M), Skipped(), writer.notices)


class _Drive:
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
        self._drive = drive
        self._course = simulation.course
        self._course.start(drive.start)
        self._wheel = wheel
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
        self.recording = Recording(wheel)
        self.hold_mph = drive.speed  # the speed that was held last, or is offered

    def run(self, stopped: StopEvent) -> str:
        """Drive until the person, a signal or the laps end it; returns the reason."""
        while not stopped.is_set():
            for request in self._wheel.requests():
                if request.kind == "end":
                    return "ended on the page"
                for text in self.recording.handle(request):
                    self._rows.event(text)
                if request.kind == "put_back":
                    self._put_on_line("the person had the car put back on its line")
            self._advance()
            if self._drive.laps is not None and self._course.laps >= self._drive.laps:
                return f"{self._drive.laps:g} laps are driven"
            self._rows.check()
            while not self._eye.keeps_up(self._step, _WAIT_S) and not stopped.is_set():
                pass
            self._real_time.wait(self._wheel.control_came)
        return "stopped at the terminal"

    def _advance(self) -> None:
        control = self._wheel.control()
        self.hold_mph = control.hold_mph or self.hold_mph
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
        is_still = throttle > 0 and abs(self._course.vehicle.speed_mph) < _STUCK_MPH
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
        self._wheel.event(why, is_problem=True)

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
            drives=drives_alone(control, is_rolling=abs(car.speed_mph) > _STUCK_MPH),
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
