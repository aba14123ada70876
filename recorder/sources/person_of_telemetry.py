"""Records a person who drives a simulator that connects: a page's controls answer each telemetry."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from recorder.errors import RecordingError
from recorder.server.braking import EmergencyBrake
from recorder.server.in_flight import RunningClock
from recorder.server.telemetry import Telemetry
from recorder.server.telemetry_server import Steer
from recorder.sources.imported_rows import Imported
from recorder.sources.live_telemetry import listen_for_telemetry
from recorder.sources.person_pedals import MAX_STANDING_MPH, brake_of_telemetry, throttle_of_telemetry
from recorder.sources.settings import ListenSettings
from recorder.teleop.frame_state import FrameState, drives_alone, hello
from recorder.teleop.rate_meter import RateMeter
from recorder.teleop.recording import Recording
from recorder.teleop.seat import Control
from recorder.teleop.wheel import Wheel

MAX_BRAKING_S: Final = 5.0  # at the end, a car that does not stop in this time is left alone
SILENT_S: Final = 0.2  # a simulator that is silent for longer is sent the brake at the end


class PersonOfTelemetry:
    """A person at the wheel of a simulator that connects: commands and recording."""

    def __init__(self, wheel: Wheel, hold_mph: float) -> None:
        """`hold_mph`: the speed that the page offers to hold."""
        self._wheel = wheel
        self.control = Control()  # the controls in force
        self._sent = Steer(0.0, 0.0)  # in force when the next telemetry's picture is taken
        self._speed_mph = math.nan
        self._rates = RateMeter()
        self._first_ns = self._last_ns = 0
        self._braking_since_s: float | None = None
        self._brake = EmergencyBrake()  # of a silent simulator
        self._clock = RunningClock()
        self._last_s = 0.0  # of a telemetry, by this clock
        self.recording = Recording(wheel)
        self.hold_mph = hold_mph  # the speed that was held last, or is offered
        self.rows = 0
        self.why = "stopped at the terminal"  # reason for the drive's end
        self.is_ended = False  # the person has ended the drive

    @property
    def brake(self) -> float:
        """The brake in force, 0 .. 1."""
        return max(0.0, -self._sent.throttle)

    def command(self, telemetry: Telemetry | None, speed_mph: float, separator: str) -> Steer:
        """The answer to a telemetry (None: an unusable one). Also shows it, with the controls in force before."""
        self._speed_mph, self._last_s = speed_mph, self._clock.tick()
        self._brake.release()
        if telemetry is not None:
            self._show(telemetry)
        self.control = self._wheel.control()
        self.hold_mph = self.control.hold_mph or self.hold_mph
        if self._braking_since_s is not None:
            self._sent = Steer(0.0, brake_of_telemetry(speed_mph), separator)
        else:
            throttle = throttle_of_telemetry(self.control, speed_mph)
            self._sent = Steer(self.control.steering, throttle, separator)
        return self._sent

    def is_at_rest(self) -> bool:
        """Brake the car at the end of the drive; True if it stands, has not stopped in `MAX_BRAKING_S`, or if its
        simulator is silent and the brake has ended."""
        now_s = time.monotonic()
        if self._braking_since_s is None:
            self._braking_since_s = now_s
        is_slow = not self._speed_mph > MAX_STANDING_MPH  # also NaN: unknown, or nothing has connected
        has_ended = self._brake.is_on and self._sent.throttle == 0.0
        return is_slow or has_ended or now_s - self._braking_since_s > MAX_BRAKING_S

    def brake_if_silent(self, separator: str) -> Steer | None:
        """The brake, or its release, for a simulator that is silent at the end of the drive; None: none is due."""
        now_s = self._clock.tick()
        if self._braking_since_s is None or now_s - self._last_s < SILENT_S or math.isnan(self._speed_mph):
            return None
        throttle = self._brake.throttle(now_s, self._speed_mph)
        if throttle == self._sent.throttle:
            return None
        self._sent = Steer(0.0, throttle, separator)
        return self._sent

    def wait_for_touch(self) -> None:
        """The simulator has gone: the next one's car gets neutral controls until the person touches anew."""
        self._wheel.wait_for_touch()

    def note_silence(self, *, is_connected: bool) -> None:
        """Let the page show that the simulator is silent, or has gone."""
        self._wheel.note_silence(self._clock.tick() - self._last_s, is_connected=is_connected)

    def takes_row(self) -> bool:
        """True if the current telemetry is to be recorded."""
        return self._braking_since_s is None and self.recording.takes_row(self.control)

    def has_row(self, time_ns: int) -> None:
        self.recording.add(time_ns, self.rows)
        self.rows += 1
        self._first_ns, self._last_ns = self._first_ns or time_ns, time_ns

    def handle_requests(self) -> list[str]:
        """Handle the person's requests; returns their events for the log."""
        events: list[str] = []
        for request in self._wheel.requests():
            events += self.recording.handle(request)
            match request.kind:
                case "put_back":
                    self._wheel.event("only the simulator itself can put the car back", is_problem=True)
                case "end":
                    self.is_ended, self.why = True, "ended on the page"
        return events

    def _show(self, telemetry: Telemetry) -> None:
        now_s = time.monotonic()
        world = telemetry.world
        simulated_s = None if world is None else world.time_s
        self._rates.add(now_s, simulated_s)
        speed_mph = 0.0 if math.isnan(telemetry.speed_mph) else telemetry.speed_mph
        state = FrameState(
            time_s=now_s if simulated_s is None else simulated_s,
            control=self.control,
            drives=drives_alone(self.control, is_rolling=abs(speed_mph) > MAX_STANDING_MPH),
            device=self.control.device,
            steering=self._sent.steering,
            throttle=self._sent.throttle,
            speed_mph=speed_mph,
            rows=self.rows,
            recorded_s=(self._last_ns - self._first_ns) / 1e9,
            is_recording=self.recording.is_on,
            pace=self._rates.pace,
            picture_hz=self._rates.frames_per_s,
            place=None if world is None else world.pose,
            laps=None if world is None else world.laps,
        )
        self._wheel.show(state.as_message(), telemetry.picture)


def listen_at_the_wheel(
    settings: ListenSettings,
    log: Path,
    hold_mph: float,
    *,
    overwrite: bool = False,
    on_wheel: Callable[[Wheel], object] | None = None,
) -> Imported:
    """Record a person's drive in a simulator that connects to `log`, until the page, Ctrl-C or silence ends it.

    `hold_mph`: the speed that the page offers to hold. `on_wheel` gets the wheel as soon as pages can connect.
    Raises as `listen_for_telemetry`.
    """
    about = hello("listen", log, hold_mph=hold_mph)
    with Wheel(f"{log.stem}, a simulator that connects", log, about) as wheel:
        if on_wheel is not None:
            on_wheel(wheel)
        person = PersonOfTelemetry(wheel, hold_mph)
        ended = {"log": str(log), "takeovers": []}
        try:
            done = listen_for_telemetry(log, settings, overwrite=overwrite, person=person)
        except RecordingError:
            wheel.end(ended | {"rows": 0, "why": f"{person.why}: nothing was recorded"})
            raise
        wheel.end(ended | {"rows": done.rows, "why": person.why})
        return done
