"""What the rows of a log show: drives, flagged rows, odd stretches, meant gaps, and how it was steered.

A writer keeps them at the log's end, so that they are known without reading the rows.
"""

from __future__ import annotations

import contextlib
import json
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from common.location import Location
from common.stretches import stretches
from common.untrusted import json_as, whole_number
from recorder import topics
from recorder.errors import LogError
from recorder.log.meant_gaps import NotRecorded
from recorder.log.reader import Log
from recorder.log.road_places import CarPlaces, states_of
from recorder.log.session_car import UDACITY, car_in, max_steering_deg_of
from recorder.rows.causes import ROW_FLAGS
from recorder.rows.odd_stretches import OddStretch, odd_stretches
from recorder.rows.row_quality import States, drive_numbers, driven_s
from recorder.rows.steering_habits import LagFinding, SteeringHabits, steering_habits
from recorder.topics import RowDevice, most_used, most_used_of

if TYPE_CHECKING:
    from foxglove_schemas_protobuf.Pose_pb2 import Pose

    from recorder.bc_pb2 import VehicleState

MAX_KEPT: Final = 100
"""Stretches that a log keeps of each kind of list; counts include all."""


@dataclass(frozen=True)
class FlaggedRows:
    """A stretch of rows that a flag holds for; times in seconds from the log's first row. A gap begins at the row
    before it."""

    flag: str
    first_row: int
    last_row: int
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class Findings:
    rows: int
    drives: int
    driven_s: float  # of all drives, without the pauses between them
    flags: dict[str, int]  # the number of rows with each flag
    stretches: list[FlaggedRows]  # the first ones
    odd: list[OddStretch]  # the first ones
    meant_gaps: list[int]  # the rows after gaps that its events explain
    steering: SteeringHabits
    lag: LagFinding | None = None  # of the steering; None: the log's writer did not measure it

    def as_metadata(self) -> dict[str, str]:
        """A log's `bc.quality` (docs/log-format.md)."""
        listed = [list(asdict(flagged).values()) for flagged in self.stretches]
        return {
            "rows": str(self.rows),
            "drives": str(self.drives),
            "driven_s": f"{self.driven_s:.3f}",
            **{flag: str(count) for flag, count in self.flags.items()},
            "stretches": json.dumps(listed),
            "odd": json.dumps([asdict(stretch) for stretch in self.odd]),
            **({"meant_gaps": json.dumps(self.meant_gaps)} if self.meant_gaps else {}),
            "steering": json.dumps(asdict(self.steering), allow_nan=False),
        }

    @classmethod
    def from_metadata(cls, quality: Mapping[str, str]) -> Findings | None:
        """The findings in a log's `bc.quality`, which is untrusted; None if an earlier version kept less."""
        odd = json_as(quality.get("odd", ""), list[OddStretch])
        steering = json_as(quality.get("steering", ""), SteeringHabits)
        if odd is None or steering is None:
            return None

        def count(name: str) -> int:
            return whole_number(quality.get(name, "")) or 0

        listed = json_as(quality.get("stretches", ""), list[tuple[str, int, int, float, float]])
        return cls(
            rows=count("rows"),
            drives=count("drives"),
            driven_s=json_as(quality.get("driven_s", ""), float) or 0.0,
            flags={flag: count(flag) for flag in ROW_FLAGS},
            stretches=[FlaggedRows(*values) for values in listed or ()],
            odd=odd,
            meant_gaps=json_as(quality.get("meant_gaps", "[]"), list[int]) or [],
            steering=steering,
            lag=_noted_lag(quality),
        )


def findings(log: Log) -> Findings | None:
    """What the writer of a log kept or, without that, what its rows show. None for other programs' logs, and for
    logs without rows. Raises LogError for a damaged log."""
    quality = log.read_metadata(topics.QUALITY_METADATA)
    if (kept := Findings.from_metadata(quality)) is not None:
        return kept
    if not log.is_ours or not log.counts.get(topics.VEHICLE):
        return None
    device, degrees = most_used_of(log.devices()), max_steering_deg_of(log)
    return _findings(states_of(log), NotRecorded.of(log), degrees, device, _noted_lag(quality))


def _noted_lag(quality: Mapping[str, str]) -> LagFinding | None:
    return json_as(f'{{"lag":{quality.get("lag", "")}}}', LagFinding)


def _findings(
    states: States,
    not_recorded: NotRecorded,
    max_steering_deg: float,
    device: RowDevice,
    lag: LagFinding | None = None,
) -> Findings:
    flagged = sorted((first, last, flag) for flag, mask in states.flags.items() for first, last in stretches(mask))
    since_s = (states.time_ns - states.time_ns[:1]) / 1e9
    return Findings(
        rows=len(states.row),
        drives=int(drive_numbers(states.time_ns)[-1]) + 1 if len(states.row) else 0,
        driven_s=driven_s(states.time_ns),
        flags={flag: int(mask.sum()) for flag, mask in states.flags.items()},
        stretches=[
            FlaggedRows(
                flag, *states.row[[first, last]].tolist(), *since_s[[first - (flag == "gap"), last]].tolist()
            )
            for first, last, flag in flagged[:MAX_KEPT]
        ],
        odd=odd_stretches(states)[:MAX_KEPT],
        meant_gaps=states.row[not_recorded.gaps(states)].tolist(),
        steering=steering_habits(states, max_steering_deg, device),
        lag=lag,
    )


class WrittenRows:
    """The rows of a log while it is written: up to 104 bytes a row."""

    def __init__(self, session: Mapping[str, str] | None, log: Location) -> None:
        """`session`: the log's metadata. A car with impossible settings counts as Udacity's; readers report it."""
        car = None
        with contextlib.suppress(LogError):
            car = car_in(session or {}, log)
        self._max_steering_deg = (car or UDACITY).max_steering_deg
        self._numbers = array("q")
        self._values = array("d")
        self._devices = Counter[int]()
        self._places = CarPlaces(session)
        self._not_recorded = NotRecorded()

    def __len__(self) -> int:
        return len(self._numbers) // 2

    def add(self, row: int, time_ns: int, state: VehicleState) -> None:
        self._numbers.extend((row, time_ns))
        self._values.extend((state.steering, state.throttle, state.brake, state.speed_mph))
        self._devices[state.device] += 1
        self._not_recorded.add_row(time_ns, state.not_recorded_s)

    def add_pose(self, row: int, pose: Pose) -> None:
        self._places.add(row, pose)

    def add_event(self, time_ns: int, text: str) -> None:
        self._not_recorded.add_event(time_ns, text)

    def states(self) -> States:
        numbers = np.array(self._numbers, np.int64).reshape(-1, 2)
        values = np.array(self._values, np.float64).reshape(-1, 4)
        return self._places.placed(States(numbers[:, 0], numbers[:, 1], *values.T))

    def meant_gaps(self, states: States) -> NDArray[np.bool_]:
        return self._not_recorded.gaps(states)

    def findings(self) -> Findings:
        return _findings(self.states(), self._not_recorded, self._max_steering_deg, most_used(self._devices))
