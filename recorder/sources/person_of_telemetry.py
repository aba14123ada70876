"""A person who drives a simulator that connects: a page's controls answer each telemetry."""

from __future__ import annotations

import math
import time
from typing import Final

from recorder.server.in_flight import RunningClock
from recorder.server.telemetry import Telemetry
from recorder.server.telemetry_server import Steer
from recorder.teleop.cockpit import Cockpit
from recorder.teleop.frame_state import drives_alone
from recorder.teleop.pedals import STANDING_MPH, EmergencyBrake, brake_of_telemetry, throttle_of_telemetry
from recorder.teleop.wheel import Request, Wheel

MAX_BRAKING_S: Final = 5.0  # at the end, a car that does not stop in this time is left alone
SILENT_S: Final = 0.2  # a simulator that is silent for longer is sent the brake at the end


class PersonOfTelemetry(Cockpit):
    """A person at the wheel of a simulator that connects: commands and recording."""

    def __init__(self, wheel: Wheel, hold_mph: float) -> None:
        super().__init__(wheel, hold_mph)
        self._sent = Steer(0.0, 0.0)  # in force when the next telemetry's picture is taken
        self._speed_mph = math.nan
        self._first_ns = self._last_ns = 0
        self._braking_since_s: float | None = None
        self._brake = EmergencyBrake()  # of a silent simulator
        self._clock = RunningClock()
        self._last_s = 0.0  # of a telemetry, by this clock
        self.rows = 0

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
        control = self.take_control()
        if self._braking_since_s is not None:
            self._sent = Steer(0.0, brake_of_telemetry(speed_mph), separator)
        else:
            self._sent = Steer(control.steering, throttle_of_telemetry(control, speed_mph), separator)
        return self._sent

    def is_at_rest(self) -> bool:
        """Brake the car at the end of the drive; True if it stands, has not stopped in `MAX_BRAKING_S`, or if its
        simulator is silent and the brake has ended."""
        now_s = time.monotonic()
        if self._braking_since_s is None:
            self._braking_since_s = now_s
        is_slow = not self._speed_mph > STANDING_MPH  # also NaN: unknown, or nothing has connected
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
        self.wheel.wait_for_touch()

    def note_silence(self, *, is_connected: bool) -> None:
        """Let the page show that the simulator is silent, or has gone."""
        self.wheel.note_silence(self._clock.tick() - self._last_s, is_connected=is_connected)

    def takes_row(self) -> bool:
        return self._braking_since_s is None and self.recording.takes_row(self.control)

    def has_row(self, time_ns: int) -> None:
        self.recording.add(time_ns, self.rows)
        self.rows += 1
        self._first_ns, self._last_ns = self._first_ns or time_ns, time_ns

    def handle(self, request: Request) -> list[str]:
        if request.kind == "put_back":
            self.wheel.event("only the simulator itself can put the car back", is_problem=True)
        return super().handle(request)

    def _show(self, telemetry: Telemetry) -> None:
        is_rolling = abs(telemetry.speed_mph) > STANDING_MPH
        state = self.state_of(
            telemetry,
            drives=drives_alone(self.control, is_rolling=is_rolling),
            device=self.control.device,
            steering=self._sent.steering,
            throttle=self._sent.throttle,
            rows=self.rows,
            recorded_s=(self._last_ns - self._first_ns) / 1e9,
        )
        self.wheel.show(state.as_message(), telemetry.picture)
