"""The summary of a drive: counters and response times that grow during the drive."""

from __future__ import annotations

import math
import time
from array import array
from collections import Counter
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from common.car import MPS_PER_MPH
from drive.control.drive_clock import DriveClock
from recorder.rows.row_quality import GAP_S
from recorder.server.world import World
from simulator.driving.course import autonomy_percent

if TYPE_CHECKING:
    from drive.control.driver import Decision  # loads PyTorch


def percentiles_ms(times_ms: array[float]) -> tuple[float, float, float]:
    """The median, the 99th percentile and the maximum; 0 without times."""
    if not times_ms:
        return 0.0, 0.0, 0.0
    p50, p99, longest = np.percentile(times_ms, (50, 99, 100), method="inverted_cdf").tolist()
    return p50, p99, longest


STAGES: Final = ("parse", "decode", "network", "total")


class DriveSummary:
    """Counts the decisions that the log holds. Its clock is the simulator's if that sends its time.

    Time counts only while telemetry comes: pauses of more than a second (`recorder.rows.row_quality.GAP_S`) by
    this computer's clock are not driving.
    """

    def __init__(self) -> None:
        self.frames = 0  # usable telemetry messages
        self.bad: Counter[str] = Counter()  # unusable telemetry messages, by kind
        self.side_problems: Counter[str] = Counter()  # unusable pictures of side cameras, by kind
        self.without_number = 0  # frames for which the network gave no number, so the car was braked
        self.manual_stretches = 0  # number of times that a human took the wheel
        self.takeovers = 0  # number of times that the expert took over
        self.put_back = 0  # number of times that the simulator put the car back on the road
        self.in_flight: Counter[int] = Counter()  # frames, by the number of messages in flight
        self.pushes = 0
        """Commands that answered no message, because the simulator was silent. `DriveSession` counts them."""
        self.unanswered = 0
        """Messages left unanswered, because too many were in flight. `DriveSession` counts them."""
        self.dropped_pictures = 0
        """Pictures that are not in the log, from `DriveLog`. `DriveSession` sets it at the end."""
        self.dropped_rows = 0  # rows and events that are not in the log, as `dropped_pictures`
        self.elapsed_s = 0.0
        self.simulated_s = 0.0  # the part of `elapsed_s` by the simulator's clock
        self.driven_s = 0.0  # the part of `elapsed_s` with usable telemetry and without the brake
        self.distance_m = 0.0
        self.times_ms = {stage: array("f") for stage in STAGES}
        """The response times of the frames: 4 MB in an hour at 60 frames a second."""
        self._clock = DriveClock()
        self._time_s = 0.0
        self._with_speed_s = 0.0  # the part of `elapsed_s` with a known speed
        self._world: World | None = None
        self._frames_with_laps = 0
        self._laps = 0.0  # sum over frames with a lap count
        self.telemetries = 0  # all answered messages: usable, unusable, and those while a human drives
        self.frames_with_interventions = 0
        """Frames whose message has the simulator's count of interventions."""
        self.speed_mph: float | None = None  # last known value, as the next three
        self.driver: Literal["pilot", "expert", "human"] = "pilot"
        self.is_braked = False
        self.steering = 0.0
        self.wanted_mph: tuple[float, float] | None = None
        """The lowest and the highest speed that the network answered; None if it answers no speed."""
        self.total_ms = 0.0  # the sum of the response times of all messages
        self.last_ms = 0.0  # the response time of the last message
        self.last_s = 0.0  # the time of a monotonic clock at which the last message was answered

    def decision(self, decision: Decision, total_ms: float, now_s: float | None = None) -> None:
        """Count a telemetry message that was answered after `total_ms`. `now_s` is by a monotonic clock."""
        telemetry = decision.telemetry
        passed_s = self._answered(total_ms, now_s, telemetry.world if telemetry is not None else None)
        self.steering = decision.steering
        self.is_braked = decision.driver == "brake"
        if decision.speed_mph is not None:
            if self.speed_mph is not None:
                self._with_speed_s += passed_s
                self.distance_m += abs(self.speed_mph) * MPS_PER_MPH * passed_s
            self.speed_mph = decision.speed_mph
        if telemetry is None:
            self.bad[decision.kind] += 1
            return
        if not self.is_braked:
            self.driven_s += passed_s
        if (wanted_mph := decision.predicted_speed_mph) is not None and math.isfinite(wanted_mph):
            lowest_mph, highest_mph = self.wanted_mph or (wanted_mph, wanted_mph)
            self.wanted_mph = min(lowest_mph, wanted_mph), max(highest_mph, wanted_mph)
        self.frames += 1
        self.side_problems.update(telemetry.side_problems)
        self.without_number += bool(decision.problem)
        self.in_flight[decision.in_flight] += 1
        for stage, ms in zip(
            STAGES, (decision.parse_ms, decision.decode_ms, decision.network_ms, total_ms), strict=True
        ):
            self.times_ms[stage].append(ms)
        if decision.driver == "expert" and self.driver != "expert":
            self.takeovers += 1
        if decision.driver == "human" and self.driver != "human":
            self.manual_stretches += 1
        if decision.driver != "brake":
            self.driver = decision.driver
        if telemetry.world is not None:
            self._course(telemetry.world)

    def manual(self, total_ms: float, now_s: float | None = None) -> None:
        self.driven_s += self._answered(total_ms, now_s, None)
        self.is_braked = False
        if self.driver != "human":
            self.manual_stretches += 1
        self.driver = "human"

    @property
    def usual_in_flight(self) -> int:
        """The most frequent number of messages in flight; 0 without frames."""
        return max(self.in_flight, key=self.in_flight.__getitem__, default=0)

    @property
    def malformed(self) -> int:
        return self.bad.total()

    @property
    def is_all_lost(self) -> bool:
        """True if no message was usable, or if the network gave no number for all frames."""
        return self.frames == self.without_number

    @property
    def no_drive_reason(self) -> str:
        if self.without_number:
            return "the network gave no number; drive with another run"
        if not self.bad:
            return "a human held the keys all the time; let go of them"
        (kind, _), *_ = self.bad.most_common(1)
        return f"no telemetry could be used ({kind}); correct this in the simulator"

    @property
    def laps(self) -> float | None:
        """The driven laps, with a fraction; None if a frame's message has no lap count."""
        return self._laps if self.frames and self._frames_with_laps == self.frames else None

    @property
    def interventions(self) -> int:
        return self.manual_stretches + self.takeovers + self.put_back

    @property
    def autonomy_percent(self) -> float | None:
        """The autonomy over the driven time; None if nothing was driven. Bojarski et al. 2016, section 7.1: each
        intervention counts as six seconds of a human's driving."""
        if self.is_all_lost or not self.driven_s:
            return None
        return autonomy_percent(self.interventions, self.driven_s)

    @property
    def mean_speed_mph(self) -> float | None:
        """The mean speed while messages give the speed, which they do not while a human drives; None if none
        did."""
        return self.distance_m / self._with_speed_s / MPS_PER_MPH if self._with_speed_s else None

    @property
    def clock(self) -> Literal["simulator", "computer", "both"]:
        if not self.simulated_s:
            return "computer"
        # a smaller difference is rounding
        return "simulator" if self.elapsed_s - self.simulated_s < 1e-3 else "both"

    def connected(self) -> None:
        """Note a connection: the next messages are of another simulator, or of another drive."""
        self._world, self.driver, self.speed_mph = None, "pilot", None

    def as_metadata(self) -> dict[str, str]:
        """The metadata record `bc.drive`, see docs/log-format.md."""
        counts = {
            name: str(getattr(self, name))
            for name in (
                *("frames", "malformed", "without_number"),
                *("interventions", "manual_stretches", "takeovers", "put_back"),
                *("dropped_pictures", "dropped_rows"),
                *("pushes", "unanswered"),
            )
        }
        if self.in_flight:
            counts |= {"in_flight": str(self.usual_in_flight), "in_flight_most": str(max(self.in_flight))}
        numbers: dict[str, float | None] = {
            "elapsed_s": self.elapsed_s,
            "driven_s": self.driven_s,
            "distance_m": self.distance_m,
            "mean_speed_mph": self.mean_speed_mph,
            "autonomy_percent": self.autonomy_percent,
            "laps": self.laps,
            "wanted_least_mph": self.wanted_mph and self.wanted_mph[0],
            "wanted_most_mph": self.wanted_mph and self.wanted_mph[1],
        }
        for stage, times_ms in self.times_ms.items():
            for name, ms in zip(("p50", "p99", "max"), percentiles_ms(times_ms), strict=True):
                numbers[f"{stage}_{name}_ms"] = ms
        measured = {name: f"{number:.3f}" for name, number in numbers.items() if number is not None}
        return counts | {"clock": self.clock} | measured

    def _answered(self, total_ms: float, now_s: float | None, world: World | None) -> float:
        """Count an answered message. Returns the seconds of driving since the message before."""
        now_s = time.monotonic() if now_s is None else now_s
        self.telemetries += 1
        self.total_ms += total_ms
        is_pause = now_s - self.last_s > GAP_S
        self.last_ms, self.last_s = total_ms, now_s
        time_s = self._clock.advance(now_s, world)
        passed_s = time_s - self._time_s + self._clock.missed_s
        self._time_s = time_s
        if self._clock.is_simulated:
            self.simulated_s += passed_s
        elif is_pause:
            return 0.0
        self.elapsed_s += passed_s
        return passed_s

    def _course(self, world: World) -> None:
        before = self._world
        self._world = world
        if before is None or (not self._clock.stands and _is_another_drive(before, world)):
            before = world
        if world.laps is not None:
            self._frames_with_laps += 1
            if before.laps is not None:
                self._laps += world.laps - before.laps
        if world.interventions is not None:
            self.frames_with_interventions += 1
            if before.interventions is not None:
                self.put_back += max(0, world.interventions - before.interventions)


def _is_another_drive(before: World, world: World) -> bool:
    """True if the time goes back: another simulator, or the same one restarted."""
    return before.time_s is not None and world.time_s is not None and world.time_s < before.time_s
