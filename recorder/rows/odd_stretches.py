"""Odd stretches of a recording, found in its numbers: rows, and the cause.

The approach to an impact, reversing, and the way out are one stretch.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.errors import counted, printable
from common.stretches import stretches_within
from recorder.rows.causes import CAUSES, NOT_LEARNT
from recorder.rows.row_quality import (
    PEDAL,
    SURELY_MPH,
    Motion,
    States,
    Values,
    drive_numbers,
    driven_backwards,
    elapsed_s,
    impact_rows,
    usual_speed_mph,
)
from recorder.rows.steering_habits import MAX_OUT_OF_RANGE

CRUMB_S: Final = 1.0
MAX_NAMED: Final = 6
MOSTLY: Final = 0.6
"""A crash without an impact in which the car reverses in a larger share of rows is driving backwards."""

CREEP_SPEED_SHARE: Final = 0.15  # of the usual speed; drivers take every bend faster
CREEP_S: Final = 2.0  # of moving; a start takes less than one
COAST_S: Final = 1.5
COAST_SPEED_SHARE: Final = 1 / 3
_ROUNDING_MPH: Final = 0.2
OFF_S: Final = 0.5  # the shortest stretch off the road: drives put a car back at once
JOIN_S: Final = 2.0  # a shorter time between two of these stretches is not driving
WHEEL_M: Final = 0.8  # from the car's middle to its wheels: half of the simulator's WHEEL_TRACK_M
WHEEL_OFF_S: Final = 5.0  # drivers who hurry cut bends for up to 3.3 s
LEAVING_S: Final = 3.0
"""The time in which a car leaves the road: a network would learn the mistake."""
FULL_LOCK: Final = 0.95
SWING_S: Final = 3.0  # at most, from full lock on one side to full lock on the other, and until the next swing
SWINGS: Final = 4
"""In a row, they are weaving. People in hairpins reach 2."""
SWUNG_RAD: Final = math.radians(10)
_MIN_ROWS: Final = 100  # to judge the scale of the steering

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class OddStretch:
    """Rows of a log that are odd for one cause; times in seconds from the log's first row."""

    kind: str  # of CAUSES
    first_row: int
    last_row: int
    begin_s: float
    end_s: float
    cause: str
    is_sure: bool  # otherwise, a person has to look at it
    is_shown: bool = False  # by the pictures; otherwise by the numbers alone

    @property
    def is_learnt(self) -> bool:
        """False if `bc-index` leaves its rows out of training by default."""
        return not self.is_sure or self.is_shown or self.kind not in (*NOT_LEARNT, "out_of_range")

    @property
    def rows(self) -> int:
        return self.last_row - self.first_row + 1

    def command(self, log: Path) -> str:
        return f"bc-log tag {shlex.quote(str(log))} exclude --rows {self.first_row} {self.last_row}"

    def __str__(self) -> str:
        kind = title_of(self.kind)
        rows = rows_named(self.first_row, self.last_row)
        perhaps = "" if self.is_sure else "perhaps "
        return f"{perhaps}{kind}: {rows}, {self.begin_s:.1f} to {self.end_s:.1f} s ({printable(self.cause)})"


def title_of(kind: str) -> str:
    """A kind in words; kinds come from logs, which are untrusted."""
    return CAUSES[kind].title if kind in CAUSES else printable(kind)


def rows_named(first: int, last: int) -> str:
    return f"row {first}" if first == last else f"rows {first} to {last}"


def odd_stretches(states: States) -> list[OddStretch]:
    """The odd stretches of a log's vehicle states, in order. No row is in two of them. Gaps in time and ordinary
    stops are not odd. Takes any numbers."""
    if not len(states.row):
        return []
    drive = drive_numbers(states.time_ns)
    taken = np.zeros(len(drive), np.bool_)
    odd = []
    for kind, mask, is_sure, cause in _kinds(states, drive):
        for first, last in stretches_within(mask & ~taken, drive):
            rows = slice(first, last + 1)
            taken[rows] = True
            is_whole = is_sure and kind not in ("weaving", "wheel_off_the_road")
            if not is_whole and states.time_ns[last] - states.time_ns[first] < CRUMB_S * 1e9:
                continue  # the edge of a stretch with another cause
            why = cause(rows) if callable(cause) else cause
            own_kind, why = why if isinstance(why, tuple) else (kind, why)
            odd.append(stretch_of(states, first, last, own_kind, why, is_sure=is_sure))
    return sorted(odd, key=lambda stretch: (stretch.first_row, stretch.last_row))


def stretch_of(states: States, first: int, last: int, kind: str, cause: str, *, is_sure: bool) -> OddStretch:
    """The stretch between two positions in the states of a log."""
    first_row, last_row = sorted((int(states.row[first]), int(states.row[last])))
    begin_s, end_s = ((states.time_ns[[first, last]] - states.time_ns[0]) / 1e9).tolist()
    return OddStretch(kind, first_row, last_row, begin_s, end_s, cause, is_sure)


_Cause = Callable[[slice], tuple[str, str] | str] | str  # the cause, or the kind and the cause; perhaps of rows


def _kinds(states: States, drive: NDArray[np.int64]) -> Iterator[tuple[str, Mask, bool, _Cause]]:
    """The kind, its rows (N,), whether it is sure, and its cause; for some rows, the cause names another kind."""
    flags = states.flags
    time_s = elapsed_s(states.time_ns)
    speed_mph = np.abs(np.where(np.isfinite(states.speed_mph), states.speed_mph, np.nan))
    motion = Motion(speed_mph, flags["standing_still"], usual_speed_mph(states), time_s, drive)
    is_hit = impact_rows(motion)

    def fastest_mph(rows: slice) -> float:
        return float(np.nanmax(speed_mph[rows], initial=0.0))

    def manoeuvre(rows: slice) -> tuple[str, str]:
        backwards, hits = flags["backwards"][rows], rows.start + np.flatnonzero(is_hit[rows])
        if not flags["crash"][rows].any() or (not len(hits) and backwards.mean() > MOSTLY):
            by_sign = (states.speed_mph[rows] < SURELY_MPH).any()
            why = "its speed is below 0" if by_sign else "its speed rises while the brake is held"
            return "backwards", f"at up to {float(np.nanmax(speed_mph[rows][backwards])):.0f} mph; {why}"
        how = f"hits something at row {states.row[hits[0]]}" if len(hits) else "stands with its wheels turned far"
        return "crash", how + (f", {counted(int(backwards.sum()), 'row')} backwards" if backwards.any() else "")

    yield "crash", flags["crash"] | flags["backwards"] | flags["manoeuvring"], True, manoeuvre
    yield "parked", flags["parked"], True, lambda rows: f"stands for {time_s[rows][-1] - time_s[rows][0]:.0f} s"
    if (beyond_m := states.beyond_m) is not None:

        def how_far(rows: slice) -> str:
            return f"its middle is up to {np.nanmax(beyond_m[rows]):.1f} m beyond the edge"

        yield "off_road", off_road_rows(beyond_m, time_s, drive), True, how_far
        leaving = leaving_rows(beyond_m, time_s, drive)
        yield "leaving_the_road", leaving, True, "it reaches the edge, where the drive breaks off"
    beyond = float((np.abs(states.steering) > 1).mean())  # False for NaN
    if beyond > MAX_OUT_OF_RANGE and len(drive) >= _MIN_ROWS:
        # without its bends, the rest would teach a network to go straight
        scale = f"steering beyond -1..1 in {beyond:.0%} of the rows: another scale, such as degrees?"
        yield "out_of_range", np.ones(len(drive), np.bool_), False, scale
    yield "out_of_range", flags["out_of_range"], True, "steering, a pedal or a speed that no car has"
    # without poses, full lock may be what a source calls any steering
    is_weaving_sure = states.heading_rad is not None
    to_and_fro = "steered from full lock to full lock, again and again"
    yield "weaving", weaving_rows(motion, states), is_weaving_sure, to_and_fro
    if beyond_m is not None:

        def how_far_off(rows: slice) -> str:
            return f"its outer wheels are up to {np.nanmax(beyond_m[rows]) + WHEEL_M:.1f} m beyond the edge"

        beside = stretch_rows(beyond_m > -WHEEL_M, time_s, drive, WHEEL_OFF_S)
        yield "wheel_off_the_road", beside, True, how_far_off

    def from_a_stand(rows: slice) -> str:
        return f"or downhill? Up to {fastest_mph(rows):.0f} mph from a stand, without throttle"

    perhaps = driven_backwards(speed_mph, states.throttle, states.brake, time_s, drive).perhaps
    yield "backwards", perhaps, False, from_a_stand
    yield "stuck_steering", flags["stuck_steering"], False, lambda rows: f"at {states.steering[rows][0]:g}"
    coasting = coasting_rows(motion, states)
    yield "coasting", coasting, False, lambda rows: f"from {fastest_mph(rows):.0f} mph without a pedal"

    def how_slow(rows: slice) -> str:
        return f"at most {fastest_mph(rows):.1f} mph, where {motion.usual_mph:.0f} mph is usual"

    yield "creeping", creeping_rows(motion), False, how_slow


def creeping_rows(motion: Motion) -> Mask:
    """The rows (N,) in which the car moves far below its usual speed for long, including short stops."""
    creeping = np.zeros(len(motion.drive), np.bool_)
    step_s = np.minimum(np.diff(motion.time_s, append=motion.time_s[-1:]), 1.0)
    for first, last in stretches_within(motion.speed_mph < CREEP_SPEED_SHARE * motion.usual_mph, motion.drive):
        moves = ~motion.standing[first : last + 1]
        if step_s[first : last + 1][moves].sum() >= CREEP_S:
            moving = first + np.flatnonzero(moves)
            creeping[moving[0] : moving[-1] + 1] = True
    return creeping


def coasting_rows(motion: Motion, states: States) -> Mask:
    """The rows (N,) in which the car rolls to a halt without throttle and brake; none if no throttle was
    recorded."""
    speed_mph, time_s = motion.speed_mph, motion.time_s
    coasting = np.zeros(len(time_s), np.bool_)
    is_pushed = states.throttle > PEDAL
    if not is_pushed.any():
        return coasting
    rises = np.diff(speed_mph, prepend=speed_mph[:1]) > _ROUNDING_MPH
    rolls = ~is_pushed & ~(states.brake > PEDAL) & ~rises & np.isfinite(speed_mph)
    for first, last in stretches_within(rolls, motion.drive):
        halt = np.flatnonzero(motion.standing[first : last + 1])
        if not len(halt) or speed_mph[first] < COAST_SPEED_SHARE * motion.usual_mph:
            continue
        stop = first + int(halt[0])
        coasting[first : stop + 1] = time_s[stop] - time_s[first] >= COAST_S
    return coasting


def off_road_rows(beyond_m: Values, time_s: Values, drive: NDArray[np.int64]) -> Mask:
    """The rows (N,) off the road, including short returns. `time_s`: from `elapsed_s`; `drive`: the number of each
    row's drive."""
    return stretch_rows(beyond_m > 0, time_s, drive, OFF_S)


def stretch_rows(mask: Mask, time_s: Values, drive: NDArray[np.int64], least_s: float) -> Mask:
    """The rows (N,) of the stretches of a mask that last `least_s` or longer. Two of them become one if the time
    between them is `JOIN_S` or less."""
    rows = np.zeros(len(drive), np.bool_)
    last_before = -1
    for first, last in stretches_within(mask, drive):
        if time_s[last] - time_s[first] < least_s:
            continue
        joins = last_before >= 0 and time_s[first] - time_s[last_before] <= JOIN_S
        rows[last_before + 1 if joins else first : last + 1] = True
        last_before = last
    return rows


def leaving_rows(beyond_m: Values, time_s: Values, drive: NDArray[np.int64]) -> Mask:
    """The rows (N,) of the `LEAVING_S` before a drive breaks off at the road's edge, and another drive begins: the
    car was put back."""
    leaving = np.zeros(len(drive), np.bool_)
    next_m = beyond_m + np.maximum(np.diff(beyond_m, prepend=beyond_m[:1]), 0.0)
    for last in np.flatnonzero((np.diff(drive) > 0) & (next_m[:-1] > -WHEEL_M)).tolist():
        leaving[np.searchsorted(time_s, time_s[last] - LEAVING_S) : last + 1] = True
    return leaving


def weaving_rows(motion: Motion, states: States) -> Mask:
    """The rows (N,) of a moving car that is steered from full lock to full lock, again and again. Its heading has
    to follow, where it is known."""
    weaving = np.zeros(len(motion.drive), np.bool_)
    left, reached = _swings(np.where(motion.standing, 0.0, states.steering))
    is_quick = motion.time_s[reached] - motion.time_s[left] <= SWING_S  # drives are farther apart
    waits = motion.time_s[left[1:]] - motion.time_s[reached[:-1]] > SWING_S  # between two swings
    in_a_row = np.cumsum(np.concatenate([[0], waits]))[: len(left)]
    for first, last in stretches_within(is_quick, in_a_row):
        rows = slice(int(left[first]), int(reached[last]) + 1)
        if last - first + 1 >= SWINGS and (
            states.heading_rad is None or _turned_rad(states.heading_rad[rows]) >= SWUNG_RAD
        ):
            weaving[rows] = True
    return weaving


def _swings(steering: Values) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The last row at full lock on one side, and the first at full lock on the other, of each change of sides."""
    locked = np.flatnonzero(np.abs(steering) >= FULL_LOCK)  # False for NaN
    changes = np.flatnonzero(np.diff(np.sign(steering[locked])))
    return locked[changes], locked[changes + 1]


def _turned_rad(heading_rad: Values) -> float:
    """The range of some headings; 0 if fewer than two are known."""
    known = heading_rad[np.isfinite(heading_rad)]
    return float(np.ptp(np.unwrap(known))) if len(known) else 0.0


def odd_lines(odd: Sequence[OddStretch]) -> list[str]:
    lines = [str(stretch) for stretch in odd[:MAX_NAMED]]
    if len(odd) > MAX_NAMED:
        lines.append(f"and {counted(len(odd) - MAX_NAMED, 'more stretch', 'more stretches')}")
    return lines


def exclude_command(odd: Sequence[OddStretch], log: Path) -> str:
    """The command that excludes all sure stretches."""
    look = " --look" * any(stretch.is_sure and stretch.is_shown for stretch in odd)
    return f"bc-log tag {shlex.quote(str(log))} exclude --odd{look}"


def odd_advice(odd: Sequence[OddStretch], log: Path, *, is_looked: bool = False) -> list[str]:
    """What happens to the odd stretches of a log, and what to do about them. `is_looked`: `bc-log check` has just
    looked at the pictures."""
    lines, place = [], shlex.quote(str(log))
    if any(not stretch.is_learnt and stretch.kind in NOT_LEARNT for stretch in odd):
        lines.append("crashes, driving backwards and parked cars are not learnt by default, if a person drove")
    if any(stretch.is_sure for stretch in odd):
        lines.append(f"`{exclude_command(odd, log)}` excludes all that is sure")
    # not those of another scale: they are all rows
    if unsure := [stretch for stretch in odd if not stretch.is_sure and stretch.kind != "out_of_range"]:
        look = "" if is_looked else f", `bc-log check {place}` looks at its pictures"
        first = f"`{unsure[0].command(log)}` excludes the first stretch"
        lines.append(f"`bc-play {place}` shows what is perhaps odd{look}; {first}")
    return lines
