"""The steering habits and the label plan of each session of an index, computed without pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from common.progress import track
from common.steering_unit import assumed_deg
from common.tasks import Tasks, one_by_one
from dataset.config import IndexConfig
from dataset.frames.distinct_rows import number_distinct
from dataset.frames.frames_file import codes, read_frames
from dataset.index.build_state import BuiltLog
from dataset.samples.samples_format import SessionLabels
from recorder.rows.label_plan import AS_RECORDED, goes_by_lag, plan_labels
from recorder.rows.row_quality import States
from recorder.rows.steering_habits import SteeringHabits, steering_habits
from recorder.topics import DEVICES, VEHICLE_COLUMNS, most_used_of


def labels_of_sessions(
    frames: Mapping[str, Path], built: Mapping[str, BuiltLog], config: IndexConfig, tasks: Tasks = one_by_one
) -> dict[str, SessionLabels]:
    """The habits and label plan of each session, from its frames file and its log's entry. Raises FramesError if a
    file is damaged."""
    names = list(frames)
    calls = [(frames[name], assumed_deg(built[name].max_steering_deg)) for name in names]
    results = track(tasks(habits_of_frames, calls), "reading the steering", len(names))
    habits = {names[number]: session_habits for number, session_habits in results}
    return {name: _labels(config, habits[name], built[name]) for name in names}


def _labels(config: IndexConfig, habits: SteeringHabits, built: BuiltLog) -> SessionLabels:
    lag = built.lag if goes_by_lag(habits, built.driven_by) else None
    plan = AS_RECORDED if config.labels == "as-recorded" else plan_labels(habits, lag, built.driven_by)
    if config.label_smooth_s is not None:
        plan = replace(plan, smooth_s=config.label_smooth_s, why=AS_RECORDED.why)
    if config.label_shift_s is not None:
        plan = replace(plan, shift_s=config.label_shift_s, why=AS_RECORDED.why)
    return SessionLabels(habits, lag.lag if lag else None, plan, built.set_speeds_mph)


def habits_of_frames(file: Path, max_steering_deg: float) -> SteeringHabits:
    """The steering habits in the rows of a session that have pictures. `max_steering_deg` is the car's angle at
    steering 1. Raises FramesError if the file is damaged."""
    names = ("row", "log_time_ns", *VEHICLE_COLUMNS)
    frames: pa.Table = read_frames(file, (*names, "device"))
    columns = [frames[name].to_numpy() for name in names]
    _, rows = number_distinct(columns[1], columns[0])
    row, time_ns, *values = (column[rows] for column in columns)
    device = most_used_of(np.maximum(codes(frames["device"], DEVICES)[rows], 0))
    states = States(row.astype(np.int64), time_ns.astype(np.int64), *values)
    return steering_habits(states, max_steering_deg, device)
