"""What happens to each telemetry: decode, crop, predict, command."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Final, Literal

from dataset.preprocess import Image
from drive.braking import EmergencyBrake
from drive.clock import DriveClock
from drive.config import DriveConfig
from drive.course_events import CourseEvents
from drive.picture import camera_picture
from drive.speed import SpeedController
from drive.steering import SteeringFilter
from drive.takeover import Takeover
from model import Pilot
from recorder.telemetry import Telemetry, TelemetryError, parse_telemetry

USUAL_SIZE: Final = (160, 320)  # height, width
NONSENSE_S: Final = 1.0
"""So long the car rolls on, steered as before, while nothing usable comes; then it is braked."""

NO_NUMBER: Final = "the network gave no number"


@dataclass(frozen=True)
class Decision:
    """The answer to one telemetry, and what led to it.

    `telemetry` and `crop` are None where the telemetry could not be used; `problem` says why. Where the network
    gave no number there is a `problem` too, but nothing was wrong with the telemetry: both are there.
    """

    steering: float  # -1..1, as sent
    throttle: float  # -1..1, as sent
    decimal_comma: bool
    driver: Literal["pilot", "expert"] = "pilot"
    telemetry: Telemetry | None = None
    crop: Image | None = None
    predicted_steering: float = 0.0  # the network's, whoever drives; not clamped, NaN if it gave no number
    parse_ms: float = 0.0  # from the telemetry's last byte until its numbers are read
    decode_ms: float = 0.0  # JPEG and crop
    network_ms: float = 0.0
    set_speed_mph: float = 0.0  # lower than asked for in a curve, if that was asked for
    problem: str = ""
    events: tuple[str, ...] = ()  # what has begun or ended with this telemetry


class Driver:
    """Drives one connected simulator."""

    def __init__(self, pilot: Pilot, config: DriveConfig) -> None:
        self._pilot = pilot
        self._clock = DriveClock()
        self._filter = SteeringFilter(config.smooth_s, config.max_steering_per_s)
        self._speed = SpeedController(config.set_speed_mph, config.slow_in_curves)
        self._brake = EmergencyBrake()
        self._takeover = Takeover() if config.takeover else None
        self._course = CourseEvents()
        self._steering = 0.0
        self._speed_mph = 0.0
        self._decimal_comma = False
        self._nonsense_since_s: float | None = None
        self._gave_number = True
        self._said_size = False
        self._said_of_world: set[str] = set()

    def decide(self, data: object, received_s: float, now_s: float | None = None) -> Decision:
        """The command for what the simulator told.

        `received_s` is when the last byte of it had come, by `time.perf_counter()`; `now_s` the time of a
        monotonic clock, for smoothing and braking where the simulator does not tell its own.

        Never raises, because an unanswered telemetry would stop the simulator's loop for good. Where one cannot be
        used, the steering is kept and the throttle let go; after `NONSENSE_S` of nothing else the car is braked.
        """
        now_s = time.monotonic() if now_s is None else now_s
        try:
            told = parse_telemetry(data)
        except TelemetryError as error:
            parsed_s = time.perf_counter()
            decision = self._without(str(error), self._clock.at(now_s, None))
        else:
            parsed_s = time.perf_counter()
            decision = self._answer(told, parsed_s, self._clock.at(now_s, told.world))
            events = self._of_world(told)
            if events:
                decision = replace(decision, events=(*events, *decision.events))
        self._steering = decision.steering
        return replace(decision, parse_ms=(parsed_s - received_s) * 1e3)

    def _of_world(self, told: Telemetry) -> list[str]:
        """What has happened on the course, and, once, what of the world cannot be used."""
        events = [] if told.world is None else self._course.after(told.world)
        for problem in told.world_problems:
            if problem not in self._said_of_world:
                self._said_of_world.add(problem)
                events.append(f"the simulator's world is not used whole: {problem}")
        return events

    def _answer(self, told: Telemetry, parsed_s: float, time_s: float) -> Decision:
        """The answer to a telemetry; whether its picture can be used is found out here."""
        self._decimal_comma, self._speed_mph = told.decimal_comma, told.speed_mph
        try:
            picture = camera_picture(told.jpeg)
        except ValueError as error:
            return self._without(f"image: {error}", time_s)
        crop = self._pilot.crop(picture)
        decoded_s = time.perf_counter()
        predicted = self._pilot.predict(crop)
        predicted_s = time.perf_counter()

        decision = (
            self._drive(told, predicted, time_s) if math.isfinite(predicted) else self._without_number(time_s)
        )
        events = decision.events
        if picture.shape[:2] != USUAL_SIZE and not self._said_size:
            self._said_size = True
            height, width = picture.shape[:2]
            events = (*events, f"pictures of {width}x{height} pixels, not 320x160: driven on all the same")
        return replace(
            decision,
            telemetry=told,
            crop=crop,
            predicted_steering=predicted,
            decode_ms=(decoded_s - parsed_s) * 1e3,
            network_ms=(predicted_s - decoded_s) * 1e3,
            events=events,
        )

    def _drive(self, told: Telemetry, predicted: float, time_s: float) -> Decision:
        events = []
        if self._brake.is_on:
            events.append("the brakes are released")
        self._brake.release()
        self._nonsense_since_s, self._gave_number = None, True
        wanted = min(max(predicted, -1.0), 1.0)
        if self._takeover is not None:
            events += self._takeover.after(time_s, told.world, wanted)
        expert = None if told.world is None else told.world.expert
        if self._takeover is not None and self._takeover.expert_drives and expert is not None:
            steering, throttle = expert
            self._filter.note(time_s, steering)
        else:
            steering = self._filter.at(time_s, wanted)
            throttle = self._speed.throttle(told.speed_mph, steering)
        return self._decision(steering, throttle, events=events)

    def _without(self, problem: str, time_s: float) -> Decision:
        """There is nothing to drive on."""
        if self._nonsense_since_s is None:
            self._nonsense_since_s = time_s
        if not self._brake.is_on and time_s - self._nonsense_since_s < NONSENSE_S:
            self._filter.note(time_s, self._steering)
            return self._decision(self._steering, 0.0, problem)
        return self._braked(problem, time_s, f"nothing usable for {NONSENSE_S:g} s: the car is braked")

    def _without_number(self, time_s: float) -> Decision:
        """The network may never give one again: there is no reason to wait."""
        was_news, self._gave_number = self._gave_number, False
        decision = self._braked(NO_NUMBER, time_s, "the car is braked")
        return replace(decision, events=(NO_NUMBER, *decision.events)) if was_news else decision

    def _braked(self, problem: str, time_s: float, event: str) -> Decision:
        events = [] if self._brake.is_on else [event]
        self._filter.note(time_s, self._steering)
        throttle = self._brake.throttle(time_s, self._speed_mph)
        return self._decision(self._steering, throttle, problem, events)

    def _decision(
        self, steering: float, throttle: float, problem: str = "", events: list[str] | None = None
    ) -> Decision:
        is_expert = self._takeover is not None and self._takeover.expert_drives
        return Decision(
            steering,
            throttle,
            self._decimal_comma,
            driver="expert" if is_expert else "pilot",
            set_speed_mph=self._speed.set_speed_for(steering),
            problem=problem,
            events=tuple(events or ()),
        )
