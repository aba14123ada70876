"""What happens to each telemetry: decode, crop, predict, command; and what is written down of it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import cv2

from dataset import decode
from dataset.preprocess import Image
from drive.speed import SpeedController
from model import Pilot
from recorder import LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.telemetry import Telemetry, TelemetryError, parse_telemetry


@dataclass(frozen=True)
class Decision:
    """The answer to one telemetry, and what led to it (None where the telemetry could not be used)."""

    steering: float  # -1..1, as sent
    throttle: float  # -1..1, as sent
    decimal_comma: bool
    telemetry: Telemetry | None = None
    crop: Image | None = None
    predicted_steering: float = 0.0
    decode_ms: float = 0.0
    network_ms: float = 0.0
    problem: str = ""


class Driver:
    """Drives one connected simulator."""

    def __init__(self, pilot: Pilot, set_speed_mph: float) -> None:
        self._pilot = pilot
        self._speed = SpeedController(set_speed_mph)
        self._steering = 0.0
        self._decimal_comma = False

    def decide(self, data: object) -> Decision:
        """The command for what the simulator told. Never raises: nonsense keeps the steering and lets go of the
        throttle, because an unanswered telemetry would stop the simulator's loop for good."""
        start_s = time.perf_counter()
        try:
            telemetry = parse_telemetry(data)
            picture = decode(telemetry.jpeg)
        except ValueError as error:  # TelemetryError is one
            what = str(error) if isinstance(error, TelemetryError) else f"image: {error}"
            return Decision(self._steering, 0.0, self._decimal_comma, problem=what)
        crop = self._pilot.crop(picture)
        decoded_s = time.perf_counter()
        predicted = self._pilot.predict(crop)
        predicted_s = time.perf_counter()
        if not math.isfinite(predicted):
            return Decision(self._steering, 0.0, telemetry.decimal_comma, problem="the network gave no number")
        self._steering = min(max(predicted, -1.0), 1.0)
        self._decimal_comma = telemetry.decimal_comma
        return Decision(
            self._steering,
            self._speed.throttle(telemetry.speed_mph),
            telemetry.decimal_comma,
            telemetry,
            crop,
            predicted,
            (decoded_s - start_s) * 1e3,
            (predicted_s - decoded_s) * 1e3,
        )

    @property
    def set_speed_mph(self) -> float:
        return self._speed.set_speed_mph


class DriveLog:
    """Writes decisions down; frames are numbered from 0, and their times never go back."""

    def __init__(self, writer: LogWriter) -> None:
        self._writer = writer
        self._last_ns = 0
        self.frames = 0

    def decision(self, decision: Decision, set_speed_mph: float, total_ms: float) -> None:
        """One answered telemetry; one that could not be used becomes an event."""
        if decision.telemetry is None or decision.crop is None:
            self.event(f"bad telemetry: {decision.problem}", is_problem=True)
            return
        time_ns, sequence, told = self._now_ns(), self.frames, decision.telemetry
        self._writer.picture("center", time_ns, sequence, told.jpeg)
        state = VehicleState(steering=told.steering, throttle=told.throttle, brake=0.0, speed_mph=told.speed_mph)
        self._writer.vehicle(time_ns, sequence, state)
        ok, png = cv2.imencode(".png", decision.crop, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not ok:  # cannot happen with a crop of ours; said rather than lost in silence
            raise RuntimeError("OpenCV could not write a PNG of the crop")
        self._writer.crop(time_ns, sequence, png.tobytes())
        command = PilotCommand(
            predicted_steering=decision.predicted_steering,
            steering=decision.steering,
            throttle=decision.throttle,
            driver=PilotCommand.PILOT,
            set_speed_mph=set_speed_mph,
            decode_ms=decision.decode_ms,
            network_ms=decision.network_ms,
            total_ms=total_ms,
        )
        self._writer.command(time_ns, sequence, command)
        self.frames += 1

    def event(self, text: str, *, is_problem: bool = False) -> None:
        self._writer.event(self._now_ns(), text, "WARNING" if is_problem else "INFO", "drive")

    def flush_if_due(self) -> None:
        self._writer.flush_if_due()

    def _now_ns(self) -> int:
        self._last_ns = max(time.time_ns(), self._last_ns + 1)
        return self._last_ns
