"""What is said of a drive at its end, and in the live line: counted along, in the same memory for hours."""

from __future__ import annotations

import time
from collections import Counter, deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from common.errors import counted
from drive.control.clock import DriveClock
from drive.log.latency import Latency
from recorder.log.row_quality import GAP_S
from recorder.server.world import World
from simulator.driving.course import INTERVENTION_COST_S
from simulator.driving.vehicle import MPS_PER_MPH

if TYPE_CHECKING:
    from drive.control.driver import Decision  # loads PyTorch

STAGES: Final = ("parse", "decode", "network", "total")
MOST_KINDS: Final = 5  # of bad telemetry, named
RATE_S: Final = 1.0  # the replies a second that are shown are those of this last while


@dataclass(frozen=True)
class _Moment:
    """How far it was when the status was asked for."""

    now_s: float
    replies: int
    bad: int  # of them
    total_ms: float  # of all of them


class DriveSummary:
    """Built up from the same decisions as the log. Its clock is the simulator's where that tells one.

    Time counts while telemetry comes: pauses of more than a second (`recorder.log.row_quality.GAP_S`) by this
    computer's clock are no driving.
    """

    def __init__(self) -> None:
        self.frames = 0
        """Telemetries that could be used."""
        self.bad: Counter[str] = Counter()
        """Those that could not, by kind."""
        self.without_number = 0
        """Frames for which the network gave no number: the car was braked."""
        self.manual_stretches = 0
        """How often a human took the wheel."""
        self.takeovers = 0
        """How often the expert did."""
        self.put_back = 0
        """How often the simulator put the car back on the road."""
        self.dropped_pictures = 0
        """As `DriveLog` counts them, and told by its owner; so are the rows."""
        self.dropped_rows = 0
        self.elapsed_s = 0.0
        self.driven_s = 0.0
        """Of that, with telemetry that was driven on."""
        self.distance_m = 0.0
        self.latency = {stage: Latency() for stage in STAGES}
        self._clock = DriveClock()
        self._time_s = 0.0
        self._told_s = 0.0  # of `elapsed_s`, with a telemetry that told the speed
        self._speed_mph: float | None = None  # as the last telemetry told it
        self._world: World | None = None
        self._frames_with_laps = 0
        self._frames_with_interventions = 0
        self.has_expert = False
        """Whether the simulator told, at least once, what an expert needs to take over."""
        self._laps = 0.0  # as far as they were told
        self._simulated_s = 0.0  # of `elapsed_s`, by the simulator's clock
        self._driver = "pilot"  # who drove last: pilot, expert or human
        self._is_braked = False
        self._steering = 0.0
        self._telemetries = 0
        self._total_ms = 0.0  # of all telemetries
        self._last_ms = 0.0
        self._last_s = 0.0
        self._moments: deque[_Moment] = deque()

    def decision(self, decision: Decision, total_ms: float, now_s: float | None = None) -> None:
        """One telemetry that was answered after `total_ms`; `now_s` is by a monotonic clock."""
        told = decision.telemetry
        passed_s = self._answered(total_ms, now_s, told.world if told is not None else None)
        self._steering = decision.steering
        self._is_braked = decision.driver == "brake"
        if decision.speed_mph is not None:
            if self._speed_mph is not None:
                self._told_s += passed_s
                self.distance_m += abs(self._speed_mph) * MPS_PER_MPH * passed_s
            self._speed_mph = decision.speed_mph
        if told is None:
            self.bad[decision.kind] += 1
            return
        if not self._is_braked:
            self.driven_s += passed_s
        self.frames += 1
        self.without_number += bool(decision.problem)
        for stage, ms in zip(
            STAGES, (decision.parse_ms, decision.decode_ms, decision.network_ms, total_ms), strict=True
        ):
            self.latency[stage].add(ms)
        if decision.driver == "expert" and self._driver != "expert":
            self.takeovers += 1
        if decision.driver != "brake":
            self._driver = decision.driver
        if told.world is not None:
            self._course(told.world)

    def manual(self, total_ms: float, now_s: float | None = None) -> None:
        """One telemetry while a human drives."""
        self.driven_s += self._answered(total_ms, now_s, None)
        self._is_braked = False
        if self._driver != "human":
            self.manual_stretches += 1
        self._driver = "human"

    @property
    def telemetries(self) -> int:
        """All that were answered: frames, malformed ones, and those of a human's driving."""
        return self._telemetries

    @property
    def malformed(self) -> int:
        return self.bad.total()

    @property
    def is_all_lost(self) -> bool:
        """Whether there was nothing that the network could drive on, or it gave no number for any of it."""
        return self.frames == self.without_number

    @property
    def why_nothing(self) -> str:
        """What to do where all is lost."""
        if self.without_number:
            return "the network gave no number; drive with another run"
        if not self.bad:
            return "a human held the keys all the time; let go of them"
        (kind, _), *_ = self.bad.most_common(1)
        return f"no telemetry could be used ({kind}); mend that in the simulator"

    @property
    def laps(self) -> float | None:
        """Driven, with the part of the present one; None where a simulator that does not tell drove some of it."""
        return self._laps if self.frames and self._frames_with_laps == self.frames else None

    @property
    def interventions(self) -> int:
        return self.manual_stretches + self.takeovers + self.put_back

    @property
    def autonomy_percent(self) -> float | None:
        """Of the time that was driven; None where none was. Bojarski et al. 2016, section 7.1: each intervention
        counts as six seconds of a human's driving."""
        if self.is_all_lost or not self.driven_s:
            return None
        lost_s = INTERVENTION_COST_S * self.interventions
        return 100.0 * max(0.0, 1.0 - lost_s / self.driven_s)

    @property
    def mean_speed_mph(self) -> float | None:
        """While the simulator told the speed; it does not while a human drives. None if it never did."""
        return self.distance_m / self._told_s / MPS_PER_MPH if self._told_s else None

    @property
    def clock(self) -> Literal["simulator", "computer", "both"]:
        """Whose seconds `elapsed_s` holds."""
        if not self._simulated_s:
            return "computer"
        # what is no more than rounding is nobody's
        return "simulator" if self.elapsed_s - self._simulated_s < 1e-3 else "both"

    def connected(self) -> None:
        """From here on another simulator tells, or the same one another drive."""
        self._world, self._driver, self._speed_mph = None, "pilot", None

    def as_metadata(self) -> dict[str, str]:
        """The metadata record `bc.drive`, see docs/log-format.md."""
        counts = {
            name: str(getattr(self, name))
            for name in (
                *("frames", "malformed", "without_number"),
                *("interventions", "manual_stretches", "takeovers", "put_back"),
                *("dropped_pictures", "dropped_rows"),
            )
        }
        numbers: dict[str, float | None] = {
            "elapsed_s": self.elapsed_s,
            "driven_s": self.driven_s,
            "distance_m": self.distance_m,
            "mean_speed_mph": self.mean_speed_mph,
            "autonomy_percent": self.autonomy_percent,
            "laps": self.laps,
        }
        for stage, latency in self.latency.items():
            numbers[f"{stage}_p50_ms"] = latency.percentile_ms(50)
            numbers[f"{stage}_p99_ms"] = latency.percentile_ms(99)
            numbers[f"{stage}_max_ms"] = latency.max_ms
        measured = {name: f"{number:.3f}" for name, number in numbers.items() if number is not None}
        return counts | {"clock": self.clock} | measured

    def lines(self) -> list[str]:
        """For people, at the end of a drive."""
        laps = "" if self.laps is None else f"{self.laps:.2f} laps, "
        speed_mph = self.mean_speed_mph
        far = (
            "distance and speed unknown"
            if speed_mph is None
            else f"{laps}{self.distance_m:,.0f} m, {speed_mph:.1f} mph on average"
        )
        lines = [
            f"{counted(self.frames, 'frame')} in {self.elapsed_s:,.1f} s{self._clock_told()}: {far}",
            f"autonomy {self._autonomy_told()}, {self._interventions_told()}{self._untold()}",
        ]
        if self.frames:
            told = (f"{stage} {latency}" for stage, latency in self.latency.items())
            lines.append(f"latency p50/p99/max in ms: {', '.join(told)}")
        if self.bad:
            what = counted(self.malformed, "telemetry", "telemetries")
            kinds = ", ".join(f"{kind} ({count:,})" for kind, count in self.bad.most_common(MOST_KINDS))
            others = len(self.bad) - MOST_KINDS
            more = f", and {counted(others, 'other kind')}" if others > 0 else ""
            lines.append(f"{what} could not be used: {kinds}{more}")
        if self.without_number:
            frames = counted(self.without_number, "frame")
            lines.append(f"the network gave no number for {frames}: the car was braked")
        if self.dropped_pictures or self.dropped_rows:
            lines.append(
                f"the disk was too slow: {counted(self.dropped_pictures, 'picture')} and"
                f" {counted(self.dropped_rows, 'row')} are not in the log"
            )
        return lines

    def status(self, now_s: float) -> str:
        """The live line, for 80 columns; empty before the first telemetry. Rates are those since the call of a
        second ago."""
        if not self._telemetries:
            return ""
        while len(self._moments) > 1 and self._moments[1].now_s <= now_s - RATE_S:
            self._moments.popleft()
        self._moments.append(_Moment(now_s, self._telemetries, self.malformed, self._total_ms))
        first, last = self._moments[0], self._moments[-1]
        replies, passed_s = last.replies - first.replies, last.now_s - first.now_s
        rate = replies / passed_s if passed_s > 0 else 0.0
        mean_ms = (last.total_ms - first.total_ms) / replies if replies else self._last_ms
        laps = "" if self.laps is None else f"{self.laps:.2f} laps, "
        helped = f"{counted(self.interventions, 'intervention')}, " if self.interventions else ""
        who = {
            "pilot": f"steer {self._steering:+.2f}",
            "expert": f"expert {self._steering:+.2f}",
            "human": "a human drives",
        }[self._driver]
        bad = last.bad - first.bad
        silent = f"{max(0.0, now_s - self._last_s):.1f} s ago"
        replied = f"{rate:.0f} Hz, {f'{bad:,} bad' if bad else f'{mean_ms:.1f} ms'}, {silent}"
        if bad and bad == replies:
            return f"{laps}{helped}{rate:.0f} Hz, none of it usable, {silent}"
        speed = "" if self._speed_mph is None else f"{self._speed_mph:.1f} mph, "
        return f"{laps}{helped}{speed}{'braked' if self._is_braked else who}, {replied}"

    def _answered(self, total_ms: float, now_s: float | None, world: World | None) -> float:
        """How long it was driven since the telemetry before."""
        now_s = time.monotonic() if now_s is None else now_s
        self._telemetries += 1
        self._total_ms += total_ms
        is_pause = now_s - self._last_s > GAP_S
        self._last_ms, self._last_s = total_ms, now_s
        time_s = self._clock.at(now_s, world)
        passed_s = time_s - self._time_s + self._clock.missed_s
        self._time_s = time_s
        if self._clock.is_simulated:
            self._simulated_s += passed_s
        elif is_pause:
            return 0.0
        self.elapsed_s += passed_s
        return passed_s

    def _course(self, world: World) -> None:
        before = self._world
        self._world = world
        if before is None or (not self._clock.stands and _is_another_drive(before, world)):
            before = world
        self.has_expert |= world.offset is not None and world.expert is not None
        if world.laps is not None:
            self._frames_with_laps += 1
            if before.laps is not None:
                self._laps += world.laps - before.laps
        if world.interventions is not None:
            self._frames_with_interventions += 1
            if before.interventions is not None:
                self.put_back += max(0, world.interventions - before.interventions)

    def _autonomy_told(self) -> str:
        autonomy = self.autonomy_percent
        if autonomy is None:
            return "unknown, for nothing was driven"
        whole = self.elapsed_s - self.driven_s < RATE_S
        return f"{autonomy:.1f} %" + ("" if whole else f" of the {self.driven_s:,.1f} s that were driven")

    def _untold(self) -> str:
        """What the interventions leave out."""
        if not self.frames:
            return ""
        frames = self.frames - self._frames_with_interventions
        if frames == self.frames:
            return " (this simulator does not tell when the car leaves the road)"
        return f" (for {counted(frames, 'frame')} nobody told when the car left the road)" if frames else ""

    def _clock_told(self) -> str:
        """Whose seconds those of the drive are, where it is not this computer's alone."""
        if self.clock == "both":
            return f" ({self._simulated_s:,.1f} s by the simulator's clock)"
        return " by the simulator's clock" if self.clock == "simulator" else ""

    def _interventions_told(self) -> str:
        whose = (
            (self.manual_stretches, "by a human"),
            (self.takeovers, "by the expert"),
            (self.put_back, "by the simulator, which put the car back"),
        )
        told = ", ".join(f"{number:,} {who}" for number, who in whose if number)
        return counted(self.interventions, "intervention") + (f": {told}" if told else "")


def _is_another_drive(before: World, world: World) -> bool:
    """Of another simulator, or of the same one, begun anew."""
    return before.time_s is not None and world.time_s is not None and world.time_s < before.time_s
