"""The driver: decodes each telemetry message, crops the picture, runs the network, and answers with a command."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

from dataset import decode
from dataset.preprocessing import Image
from drive.config import DriveConfig
from drive.control.drive_clock import CourseEvents, DriveClock
from drive.control.speed_controller import SpeedController
from drive.control.takeover import PersonTakeover, Takeover
from model import Pilot
from model.pilot import NetworkAnswer
from recorder.log.session_car import UDACITY
from recorder.pictures.picture_size import pixels
from recorder.server.locale_numbers import POINT
from recorder.server.telemetry import Telemetry, TelemetryError, check_whole_picture, parse_telemetry
from recorder.server.world import World, WorldNotices
from recorder.teleop.pedals import WALKING_MPH, EmergencyBrake
from recorder.topics import Device

MAX_PIXELS: Final = 1 << 21
"""The largest accepted picture. 1920x1080 is just within, and takes 10 ms to decode. A message may hold a
megabyte, which can decode to 60 million pixels; during the second that this takes, nobody would control the
car."""


def camera_picture(encoded: bytes) -> tuple[Image, tuple[int, int]]:
    """The picture (height, width, 3) BGR, and the width and height in its header: decoding may rotate it by EXIF.

    Raises TelemetryError for an incomplete picture, and for more than `MAX_PIXELS`.
    """
    try:
        size = check_whole_picture(encoded)
    except TelemetryError:
        _refuse_too_large(pixels(encoded))
        raise
    _refuse_too_large(size[0] * size[1])
    try:
        return decode(encoded), size
    except ValueError as error:
        raise TelemetryError("image does not decode", f" ({error})") from None


def _refuse_too_large(size: int) -> None:
    if size > MAX_PIXELS:
        raise TelemetryError(f"image has more than {MAX_PIXELS:,} pixels", f" ({size:,})")


class SteeringFilter:
    """Exponential smoothing and a rate limit for steering in -1..1; it starts with the wheels straight.

    `smooth_s` is the time constant of the smoothing (63 % of a jump after one, 95 % after three), `max_per_s` the
    largest change in a second; 0 switches each off. The filter is in time, not in messages: 10 and 50 messages a
    second give the same steering over time.
    """

    def __init__(self, smooth_s: float = 0.0, max_per_s: float = 0.0) -> None:
        self._smooth_s = smooth_s
        self._max_per_s = max_per_s
        self._sent = 0.0
        self._time_s = 0.0

    def apply(self, time_s: float, wanted: float) -> float:
        """The steering to send at `time_s`, which must not go back."""
        passed_s = time_s - self._time_s
        change = wanted - self._sent
        if self._smooth_s:
            change *= -math.expm1(-passed_s / self._smooth_s)
        if self._max_per_s:
            max_change = self._max_per_s * passed_s
            change = min(max(change, -max_change), max_change)
        # without a limit, exactly `wanted`: adding the difference would round
        sent = wanted if change == wanted - self._sent else self._sent + change
        self.override(time_s, sent)
        return sent

    def override(self, time_s: float, sent: float) -> None:
        """Continue from the steering `sent`, which another driver has sent."""
        self._sent, self._time_s = sent, time_s


USUAL_SIZE: Final = (160, 320)  # height, width
MIN_AHEAD_S: Final = 0.5
"""Minimum time to reach an answered speed: a car cannot change its speed at once, even if the network answers the
speed at the picture."""

UNUSABLE_S: Final = 1.0
"""Without usable telemetry, the car rolls on for this time, steered as before; then it is braked."""

NO_NUMBER: Final = "the network gave no number"
NOTHING_USABLE: Final = f"nothing usable for {UNUSABLE_S:g} s"


@dataclass(frozen=True)
class Decision:
    """The answer to one telemetry message, and its origin.

    If the message could not be used, `telemetry` and `crop` are None, and `problem` is the reason. If the network
    gave no number, there is a `problem`, too, but `telemetry` and `crop` are given. If the message is left
    unanswered, there is a `telemetry`, but no `crop`.
    """

    steering: float  # -1..1, as sent
    throttle: float  # -1..1, as sent
    decimal_separator: str = POINT
    driver: Literal["pilot", "human", "expert", "brake"] = "pilot"  # the source of the throttle
    device: Device | None = None  # of a human driver
    speed_mph: float | None = None  # of the car; may be known even if the message could not be used
    telemetry: Telemetry | None = None
    picture_size: tuple[int, int] | None = None  # width, height; None if the message could not be used
    crop: Image | None = None
    predicted_steering: float = 0.0  # the network's, also while the expert drives; not clamped, may be NaN
    predicted_speed_mph: float | None = None  # the network's; None: it does not answer the speed
    predicted_throttle: float | None = None  # the network's; None: it does not answer the throttle
    parse_ms: float = 0.0  # time to read the numbers of the message
    decode_ms: float = 0.0  # time to decode and crop the picture
    network_ms: float = 0.0
    set_speed_mph: float = 0.0  # lower than the configured one if the network, or a curve, needs less
    problem: str = ""
    kind: str = ""  # of the problem: equal for problems that differ only in their values
    events: tuple[str, ...] = ()  # that happened with this message
    in_flight: int = 1  # messages, including this one
    is_answered: bool = True


class Driver:
    def __init__(
        self,
        pilot: Pilot,
        config: DriveConfig,
        *,
        person: PersonTakeover | None = None,
    ) -> None:
        self._has_reported_size = False
        self._pilot = pilot
        self._clock = DriveClock()
        self._filter = SteeringFilter(config.smooth_s, config.max_steering_per_s)
        self._car = config.car or UDACITY
        ahead_s = max(pilot.speed_ahead_s, MIN_AHEAD_S)
        self._speed = SpeedController(config.set_speed_mph, config.slow_in_curves, ahead_s, config.car)
        self._brake = EmergencyBrake()
        self._last_brake: EmergencyBrake | None = None
        self._takeover = Takeover() if config.takeover else None
        self.person = person  # who may take over from the network
        self._course = CourseEvents()
        self._steering = 0.0
        self._network = 0.0, 0.0  # the last steering and throttle without the person's
        self._speed_mph: float | None = None  # the last known speed
        self._decimal_separator: str | None = None  # the last known separator
        self._unusable_since_s: float | None = None
        self._gave_number = True
        self._world_notices = WorldNotices()

    def decide(self, data: object, received_s: float, now_s: float | None = None) -> Decision:
        """The command that answers a telemetry message: its data, or a `Telemetry` with valid numbers.

        `received_s` is the `time.perf_counter()` when its handling began. `now_s` is the time of a monotonic
        clock: for braking, and for smoothing if the simulator does not send its time.

        Never raises, because the simulator would wait for ever for an answer. If a message cannot be used, the
        steering stays and the throttle is 0; after `UNUSABLE_S` without a usable message, the car is braked.
        """
        now_s = time.monotonic() if now_s is None else now_s
        try:
            telemetry = self._parsed(data)
        except TelemetryError as error:
            parsed_s = time.perf_counter()
            world, problems, speed_mph = error.world, error.world_problems, error.speed_mph
            self._note(speed_mph, error.decimal_separator)
            time_s = self._clock.advance(now_s, world)
            decision = self._answer_unusable(error, time_s)
        else:
            parsed_s = time.perf_counter()
            world, problems = telemetry.world, telemetry.world_problems
            speed_mph = telemetry.speed_mph if math.isfinite(telemetry.speed_mph) else None
            self._note(telemetry.speed_mph, telemetry.observed_separator)
            time_s = self._clock.advance(now_s, world)
            decision = self._answer_by_network(telemetry, parsed_s, time_s)
        if events := self._world_events(world, problems):
            decision = replace(decision, events=(*events, *decision.events))
        self._network = decision.steering, decision.throttle
        if self.person is not None:  # last, so that the newest controls count
            decision = self._with_person(decision, self.person, time_s)
        if self._last_brake is not None:
            throttle = self._last_brake.throttle(self._clock.safety_s, self._speed_mph)
            decision = replace(decision, throttle=throttle, driver="brake")
        self._steering = decision.steering
        return replace(decision, speed_mph=speed_mph, parse_ms=(parsed_s - received_s) * 1e3)

    def read(self, data: object) -> Decision:
        """A telemetry message that is left unanswered, for the log: as `decide`, but without a command."""
        try:
            telemetry = self._parsed(data)
            self._note(telemetry.speed_mph, telemetry.observed_separator)
            size = check_whole_picture(telemetry.picture)
        except TelemetryError as error:
            self._note(error.speed_mph, error.decimal_separator)
            return Decision(0.0, 0.0, problem=str(error), kind=error.kind, is_answered=False)
        return Decision(0.0, 0.0, telemetry=telemetry, picture_size=size, is_answered=False)

    def stop(self) -> None:
        """Brake the car to a stand from now on, with the steering as before."""
        self._last_brake = EmergencyBrake()

    def go_on_without_telemetry(self) -> tuple[float, float, list[str]]:
        """Steering and throttle while no telemetry comes, and events: the newest command of a person who is at the
        wheel, else the network's last one. They never brake: a simulator that stays silent keeps a command for
        ever, and a brake would finally reverse its car."""
        events = [] if self.person is None else self.person.update(is_braked=False)
        if self.person is not None and self.person.person_drives:
            self._steering, throttle = self.person.command(self._speed_mph)
        else:
            self._steering, throttle = self._network
        return self._steering, max(0.0, throttle), events

    def brake_without_telemetry(self) -> tuple[float, float]:
        """Steering and throttle after `stop`, while no telemetry comes: full brake, then throttle 0."""
        self._clock.advance(time.monotonic(), None)
        if self._last_brake is None:
            return self._steering, 0.0
        return self._steering, self._last_brake.throttle(self._clock.safety_s, self._speed_mph)

    def _parsed(self, data: object) -> Telemetry:
        if isinstance(data, Telemetry):
            return data
        return parse_telemetry(data, self._decimal_separator, self._car)

    def _note(self, speed_mph: float | None, decimal_separator: str | None) -> None:
        if speed_mph is not None and math.isfinite(speed_mph):
            self._speed_mph = speed_mph
        if decimal_separator is not None:
            self._decimal_separator = decimal_separator

    def _world_events(self, world: World | None, problems: Sequence[str]) -> list[str]:
        events = [] if world is None else self._course.update(world)
        return events + self._world_notices.new_notices(problems, clock_stands=self._clock.stands)

    def _answer_by_network(self, telemetry: Telemetry, parsed_s: float, time_s: float) -> Decision:
        """The answer to a telemetry message with valid numbers. Its picture may still be unusable."""
        try:
            picture, size = camera_picture(telemetry.picture)
        except TelemetryError as error:
            return self._answer_unusable(error, time_s)
        crop = self._pilot.crop(picture)
        decoded_s = time.perf_counter()
        answer = self._pilot.answer(crop)
        predicted_s = time.perf_counter()

        decision = (
            self._drive(telemetry, answer, time_s) if answer.is_finite else self._answer_without_number(time_s)
        )
        events = decision.events
        if picture.shape[:2] != USUAL_SIZE and not self._has_reported_size:
            self._has_reported_size = True
            height, width = picture.shape[:2]
            events = (*events, f"pictures of {width}x{height} pixels, not 320x160: used nevertheless")
        return replace(
            decision,
            telemetry=telemetry,
            picture_size=size,
            crop=crop,
            predicted_steering=answer.steering,
            predicted_speed_mph=answer.speed_mph,
            predicted_throttle=answer.throttle,
            decode_ms=(decoded_s - parsed_s) * 1e3,
            network_ms=(predicted_s - decoded_s) * 1e3,
            events=events,
        )

    def _drive(self, telemetry: Telemetry, answer: NetworkAnswer, time_s: float) -> Decision:
        events = []
        if self._brake.is_on:
            events.append("the brakes are released")
        self._brake.release()
        self._unusable_since_s, self._gave_number = None, True
        predicted = min(max(answer.steering, -1.0), 1.0)
        if self._takeover is not None:
            events += self._takeover.update(time_s, telemetry.world, predicted)
        expert = None if telemetry.world is None else telemetry.world.expert
        if self._takeover is not None and self._takeover.expert_drives and expert is not None:
            steering, throttle = expert
            self._filter.override(time_s, steering)
        else:
            steering = self._filter.apply(time_s, predicted)
            throttle = self._throttle(telemetry, answer, steering, time_s)
        target_mph = math.inf if answer.speed_mph is None else answer.speed_mph
        return self._decision(steering, throttle, events=events, target_mph=target_mph)

    def _with_person(self, decision: Decision, person: PersonTakeover, time_s: float) -> Decision:
        """The decision, replaced by the command of the person at the wheel while the person drives."""
        is_braked = self._last_brake is not None or decision.driver == "brake"
        events = (*decision.events, *person.update(is_braked=is_braked))
        if not person.person_drives:
            return replace(decision, events=events)
        steering, throttle = person.command(self._speed_mph)
        self._filter.override(time_s, steering)
        self._brake.release()
        return replace(
            decision, steering=steering, throttle=throttle, driver="human", device=person.device, events=events
        )

    def _throttle(self, telemetry: Telemetry, answer: NetworkAnswer, steering: float, time_s: float) -> float:
        """The throttle for the car's speed. If the speed is unknown: the expert's if the simulator sends it, else
        0.

        The network's own throttle is limited so that the car stays at or below the set speed.
        """
        speed_mph = telemetry.speed_mph
        if math.isfinite(speed_mph):
            if answer.speed_mph is not None:
                return self._speed.follow(time_s, speed_mph, answer.speed_mph, steering)
            if answer.throttle is not None:
                return self._speed.follow(time_s, speed_mph, math.inf, steering, max_throttle=answer.throttle)
            return self._speed.throttle(speed_mph, steering)
        expert = None if telemetry.world is None else telemetry.world.expert
        return 0.0 if expert is None else expert[1]

    def _answer_unusable(self, problem: TelemetryError, time_s: float) -> Decision:
        """The answer to an unusable telemetry message: the car rolls on, and brakes after `UNUSABLE_S`."""
        now_s = self._clock.safety_s
        if self._unusable_since_s is None:
            self._unusable_since_s = now_s
        if not self._brake.is_on and now_s - self._unusable_since_s < UNUSABLE_S:
            self._filter.override(time_s, self._steering)
            return self._decision(self._steering, 0.0, str(problem), problem.kind)
        return self._answer_braking(str(problem), problem.kind, time_s, f"{NOTHING_USABLE}: ")

    def _answer_without_number(self, time_s: float) -> Decision:
        """The answer if the network gave NaN: brake at once, because the network may never recover."""
        is_first, self._gave_number = self._gave_number, False
        decision = self._answer_braking(NO_NUMBER, NO_NUMBER, time_s)
        return replace(decision, events=(NO_NUMBER, *decision.events)) if is_first else decision

    def _answer_braking(self, problem: str, kind: str, time_s: float, why: str = "") -> Decision:
        events = [] if self._brake.is_on else [why + _braking_text(self._speed_mph)]
        self._filter.override(time_s, self._steering)
        throttle = self._brake.throttle(self._clock.safety_s, self._speed_mph)
        return replace(self._decision(self._steering, throttle, problem, kind, events), driver="brake")

    def _decision(
        self,
        steering: float,
        throttle: float,
        problem: str = "",
        kind: str = "",
        events: list[str] | None = None,
        target_mph: float = math.inf,
    ) -> Decision:
        is_expert = self._takeover is not None and self._takeover.expert_drives
        return Decision(
            steering,
            throttle,
            self._decimal_separator or POINT,
            driver="expert" if is_expert else "pilot",
            set_speed_mph=self._speed.set_speed_for(steering, target_mph),
            problem=problem,
            kind=kind,
            events=tuple(events or ()),
        )


def _braking_text(speed_mph: float | None) -> str:
    if speed_mph is None:
        return "the car is braked as from its top speed, because its speed is unknown"
    return "the car stands" if speed_mph <= WALKING_MPH else "the car is braked"
