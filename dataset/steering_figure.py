"""A figure of an index's sessions: the steering of each, and its labels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from common.errors import printable
from common.location import local_path
from common.stretches import stretches
from dataset.errors import DatasetError
from dataset.figure_style import BLUE, GREY, ORANGE, new_figure
from dataset.frames.distinct_rows import number_distinct
from dataset.frames.frames_file import read_frames
from dataset.samples.labels import planned_labels
from dataset.samples.samples_format import SessionLabels
from dataset.samples.samples_reader import Samples
from dataset.steering_bins import BINS
from recorder.rows.row_quality import APART_S, Values, drive_numbers, elapsed_s
from recorder.rows.steering_report import in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_SESSIONS: Final = 6  # the first ones by name: more are too small to read
SHOWN_S: Final = 30.0
_EDGES: Final = np.linspace(-1, 1, BINS + 1).tolist()


@dataclass(frozen=True)
class SteeredSession:
    """The rows of a session; arrays of one length."""

    name: str
    labels: SessionLabels
    time_s: Values  # since the first row; what lies between drives counts as a second
    is_first: NDArray[np.bool_]  # of a drive
    recorded: Values
    label: Values  # NaN where there is none, and in a crash
    is_crash: NDArray[np.bool_]


def steered_sessions(samples: Samples) -> list[SteeredSession]:
    """The first sessions of an index that have frames. Raises DatasetError if it is damaged, or of an earlier
    version."""
    found: list[SteeredSession] = []
    for name in samples.sources:
        if len(found) == MAX_SESSIONS:
            break
        try:
            labels = msgspec.convert(samples.metadata["labels"][name], SessionLabels)
        except (KeyError, TypeError, ValueError):
            raise DatasetError(
                f"{samples.path}: does not say how {name} was steered; build it again with `bc-index`"
            ) from None
        frames = read_frames(local_path(samples.path).parent / "frames" / f"{name}.parquet")
        if not len(frames):
            continue
        label, is_crash = planned_labels(frames, labels.plan)
        time_ns, row = (frames[column].to_numpy() for column in ("log_time_ns", "row"))
        _, rows = number_distinct(time_ns, row)
        drive = drive_numbers(time_ns[rows])
        found.append(
            SteeredSession(
                name,
                labels,
                elapsed_s(time_ns[rows]) - drive * (APART_S - 1.0),
                np.diff(drive, prepend=-1) != 0,
                frames["steering"].to_numpy()[rows],
                np.where(is_crash, np.nan, label)[rows],
                is_crash[rows],
            )
        )
    return found


def draw_steering(sessions: list[SteeredSession]) -> Figure:
    """A row each: the 30 s in which most is steered, as driven and as learnt, and how often which steering is."""
    figure = new_figure(1.35 * len(sessions) + 1.2)
    grid = figure.subplots(len(sessions), 2, squeeze=False, width_ratios=(4, 1), sharey=True)
    for (course, histogram), session in zip(grid, sessions, strict=True):
        _draw_course(course, session)
        _draw_histogram(histogram, session)
    handles = {
        name: handle for axes in grid[:, 0] for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend([*handles.values()], [*handles], loc="outside upper center", ncols=3)
    grid[-1, 0].set_xlabel("time (s)")
    grid[-1, 1].set_xlabel("rows")
    figure.align_labels()
    return figure


def _draw_course(axes: Axes, session: SteeredSession) -> None:
    labels = session.labels
    words = in_words(labels.habits, labels.lag, labels.plan)
    first, last = _busiest(session)
    part = slice(first, last + 1)
    time_s = session.time_s[part] - session.time_s[first]
    edges = np.flatnonzero(session.is_first[part])  # no line from drive to drive
    recorded, label = (np.insert(of[part], edges, np.nan) for of in (session.recorded, session.label))
    at_s = np.insert(time_s, edges, np.nan)
    axes.plot(at_s, recorded, color=BLUE, linewidth=0.9, label="as recorded")
    axes.plot(at_s, label, color=ORANGE, linewidth=1.4, label="as learnt")
    for begin, end in stretches(session.is_crash[part]):
        axes.axvspan(
            time_s[begin], time_s[end], color=GREY, alpha=0.25, linewidth=0, label="crash or the like, not learnt"
        )
    axes.set_title(f"{printable(session.name)}: {words}", loc="left", parse_math=False)  # a $ is part of a name
    axes.set_xlim(0, SHOWN_S)
    axes.set_ylim(-1.05, 1.05)
    axes.set_yticks([-1, 0, 1])
    axes.set_ylabel("steering")


def _draw_histogram(axes: Axes, session: SteeredSession) -> None:
    recorded, label = (steering[np.abs(steering) <= 1] for steering in (session.recorded, session.label))
    axes.hist(recorded, _EDGES, orientation="horizontal", log=True, color=BLUE, alpha=0.35)
    axes.hist(label, _EDGES, orientation="horizontal", log=True, color=ORANGE, histtype="step", linewidth=1.2)


def _busiest(session: SteeredSession) -> tuple[int, int]:
    """The first and the last row of the 30 s, from some whole ten seconds on, in which steering spreads most."""
    time_s, steering = session.time_s, np.nan_to_num(session.recorded, posinf=0, neginf=0)
    starts = np.searchsorted(time_s, np.arange(0, max(time_s[-1] - SHOWN_S, 0) + 1e-6, 10.0))
    ends = np.searchsorted(time_s, time_s[starts] + SHOWN_S, side="right") - 1
    steering = np.where(session.is_crash, 0.0, steering)
    spread = [steering[a : b + 1].std() for a, b in zip(starts, ends, strict=True)]
    best = int(np.argmax(spread))
    return int(starts[best]), int(ends[best])
