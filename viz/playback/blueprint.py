"""The layout of a log in the viewer, a function of the log's topics."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from recorder.bc_pb2 import PilotCommand
from recorder.topics import (
    EVENTS,
    PILOT_COMMAND,
    PILOT_INPUT,
    PLOTS,
    POSE,
    PREDICTIONS,
    SPEED,
    STEERING,
    TOPICS,
    VEHICLE,
    ColorName,
    Plot,
    Topic,
    camera_topic,
)
from viz.timelines import SINCE_START

AROUND_S: Final = 1.0
"""Seconds before and after the requested moment that play in a loop if the time cursor cannot be set."""

CENTER: Final = camera_topic("center")
ERRORS: Final = "/error_deg"
DRIVER: Final = "/driver"
HISTOGRAM: Final = "/histogram/recorded"
PATH: Final = "/path/driven"
CAR: Final = "/path/car"
DRIVEN_SPEED: Final = f"{SPEED.path}/driven"

Color = tuple[int, int, int]
Part = rrb.View | rrb.Container
Shared = tuple[Part, float]  # a part of the layout and its share of the height

COLORS: Final[Mapping[ColorName, Color]] = {
    "blue": (120, 160, 255),
    "orange": (255, 160, 60),
    "green": (110, 210, 110),
    "violet": (200, 140, 230),
    "grey": (160, 160, 160),
    "red": (230, 90, 90),
}
"""Colours by their names in the registry of topics."""
BLUE, ORANGE, GREEN, VIOLET, GREY, RED = COLORS.values()

DRIVERS: Final[Mapping[int, tuple[str, Color]]] = {
    PilotCommand.UNKNOWN: ("unknown", GREY),
    PilotCommand.PILOT: ("pilot", GREEN),
    PilotCommand.HUMAN: ("human", ORANGE),
    PilotCommand.EXPERT: ("expert", BLUE),
    PilotCommand.BRAKE: ("brake", RED),
}
"""Names and colours of the drivers."""

LOG_COLORS: Final = (BLUE, ORANGE, GREEN, VIOLET, RED, GREY)  # colours of logs that are compared

DRIVER_VIEW: Final = "who drives"
ERROR: Final = "error in degrees: predicted - recorded"
_DRIVER_SHARE: Final = 0.9  # of the height
_FRAME_SHARE: Final = 3.0  # of the height, in a comparison


@dataclass(frozen=True)
class Curve:
    entity: str
    name: str
    color: Color


ARCS: Final[Mapping[str, float]] = {"/steering/recorded": 2.5, "/steering/predicted": 2.0, "/steering/sent": 1.5}
"""Steering that is also drawn over the frame: curve and half the line's width."""


def log_layout(
    topics: Collection[str],
    runs: Sequence[str] = (),
    attention: Sequence[str] = (),
    *,
    grows: bool = False,
    at_s: float | None = None,
) -> rrb.Blueprint:
    """The layout for a log with these topics, without views for missing topics.

    `runs` are the names of runs with predictions for the log, `attention` of runs with attention maps. If the log
    grows, the layout follows its end; else it opens at the start, or `at_s` seconds after it.
    """
    attention_views = [
        rrb.Spatial2DView(origin=attention_entity(run), name=f"where {run} looks") for run in attention
    ]
    plots = _plots(topics, has_errors=bool(runs) or _has_predictions(topics))
    if runs or EVENTS in topics or not topics:
        plots.append((rrb.TextLogView(origin=EVENTS, name=TOPICS[EVENTS].title), 1.0))
    parts = _side_by_side([_pictures(topics, attention_views), _upright(plots)], shares=[2, 3])
    return _blueprint(parts, _time_panel(SINCE_START, grows=grows, at_s=at_s))


def comparison_layout(
    logs: Mapping[str, Collection[str]], timeline: str, *, at_s: float | None = None
) -> rrb.Blueprint:
    """The layout for several logs side by side on `timeline`. `logs` has the topics of each log by its name. It
    opens at their start, or `at_s` seconds after it."""
    columns = [_column(name, topics) for name, topics in logs.items()]
    together: list[Part] = []
    with_states = [name for name, topics in logs.items() if _has_lines(SPEED, topics)]
    with_poses = [name for name, topics in logs.items() if POSE in topics]
    if with_states:
        driven = [log_entity(name) + DRIVEN_SPEED for name in with_states]
        together.append(rrb.TimeSeriesView(origin="/", contents=driven, name=SPEED.title))
    if with_poses:
        ways = [f"{log_entity(name)}/path/**" for name in with_poses]
        together.append(rrb.Spatial2DView(origin="/", contents=ways, name="paths from above, m"))
    rows = [rrb.Horizontal(*columns), *([rrb.Horizontal(*together)] if together else [])]
    return _blueprint(rrb.Vertical(*rows, row_shares=[3, 1][: len(rows)]), _time_panel(timeline, at_s=at_s))


def attention_entity(run: str) -> str:
    return f"/attention/{rr.escape_entity_path_part(run)}"


def log_entity(name: str) -> str:
    """The parent entity of one of several logs."""
    return f"/{rr.escape_entity_path_part(name)}"


def _pictures(topics: Collection[str], attention_views: Sequence[rrb.View]) -> Part | None:
    parts: list[Shared] = []
    if CENTER in topics:
        parts.append((_view(TOPICS[CENTER]), 3.0))
    pictures = [topic for name, topic in TOPICS.items() if topic.is_picture and name in topics and name != CENTER]
    if sides := [_view(topic) for topic in pictures if topic.camera is not None]:
        parts.append((rrb.Horizontal(*sides), 1.5))
    small: list[Part] = [_view(topic) for topic in pictures if topic.camera is None]
    small.extend(attention_views)
    if POSE in topics:
        small.append(rrb.Spatial2DView(origin="/path", name="path from above, m"))
    if small:
        parts.append((rrb.Grid(*small, grid_columns=min(2, len(small))), 2.0 if len(small) <= 2 else 4.0))
    return _upright(parts)


def _plots(topics: Collection[str], *, has_errors: bool) -> list[Shared]:
    plots = _driving(topics, "", "", has_steering=has_errors or _has_lines(STEERING, topics))
    if has_errors:
        plots.append((rrb.TimeSeriesView(origin=ERRORS, name=ERROR), 1.0))
    plots += [_plot(plot) for plot in PLOTS if plot != STEERING and _has_lines(plot, topics)]
    if VEHICLE in topics:
        plots.append((rrb.BarChartView(origin="/histogram", name="frames by steering, 25 bins"), 1.0))
    return plots


def _driving(topics: Collection[str], at: str, prefix: str, *, has_steering: bool) -> list[Shared]:
    """The views of the driver and the steering. Entities begin with `at`, names of views with `prefix`."""
    plots: list[Shared] = []
    if PILOT_COMMAND in topics:
        plots.append((rrb.StateTimelineView(origin=at + DRIVER, name=prefix + DRIVER_VIEW), _DRIVER_SHARE))
    if has_steering:
        plots.append(_plot(STEERING, at, prefix))
    return plots


def _plot(plot: Plot, at: str = "", prefix: str = "") -> Shared:
    axis = None if plot.range is None else rrb.ScalarAxis(range=plot.range, zoom_lock=True)
    return rrb.TimeSeriesView(origin=at + plot.path, name=prefix + plot.title, axis_y=axis), plot.height


def _has_lines(plot: Plot, topics: Collection[str]) -> bool:
    return any(line.plot == plot for name in topics if name in TOPICS for line in TOPICS[name].lines)


def _view(picture: Topic, at: str = "", prefix: str = "") -> rrb.View:
    return rrb.Spatial2DView(origin=at + picture.name, name=prefix + picture.title)


def _column(name: str, topics: Collection[str]) -> rrb.Container:
    at, prefix = log_entity(name), f"{name}: "
    frames: list[Part] = []
    frames += [_view(TOPICS[name], at, prefix) for name in (CENTER, PILOT_INPUT) if name in topics]
    parts: list[Shared] = [(_side_by_side(frames, shares=[2, 1][: len(frames)]), _FRAME_SHARE)] if frames else []
    has_predictions = _has_predictions(topics)
    parts += _driving(topics, at, prefix, has_steering=has_predictions or _has_lines(STEERING, topics))
    if has_predictions:
        parts.append((rrb.TimeSeriesView(origin=at + ERRORS, name=prefix + ERROR), 1.0))
    if EVENTS in topics or not parts:
        parts.append((rrb.TextLogView(origin=at + EVENTS, name=prefix + TOPICS[EVENTS].title), 1.0))
    return rrb.Vertical(*(part for part, _ in parts), row_shares=[share for _, share in parts], name=name)


def _has_predictions(topics: Collection[str]) -> bool:
    return any(topic.startswith(PREDICTIONS) for topic in topics)


def _upright(parts: Sequence[Shared]) -> Part | None:
    if not parts:
        return None
    return rrb.Vertical(*(part for part, _ in parts), row_shares=[share for _, share in parts])


def _side_by_side(parts: Sequence[Part | None], shares: Sequence[float]) -> Part:
    present = [(part, share) for part, share in zip(parts, shares, strict=True) if part is not None]
    return rrb.Horizontal(*(part for part, _ in present), column_shares=[share for _, share in present])


def _time_panel(timeline: str, *, grows: bool = False, at_s: float | None = None) -> rrb.TimePanel:
    """The time panel. A layout cannot set the time cursor: with `at_s`, the time around `at_s` plays in a loop."""
    if at_s is None:
        return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following" if grows else "paused")
    around = AbsoluteTimeRange(min=round(1e9 * max(0.0, at_s - AROUND_S)), max=round(1e9 * (at_s + AROUND_S)))
    return rrb.TimePanel(
        state="collapsed", timeline=timeline, play_state="playing", loop_mode="selection", time_selection=around
    )


def _blueprint(parts: Part, time_panel: rrb.TimePanel) -> rrb.Blueprint:
    return rrb.Blueprint(
        parts, time_panel, rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed")
    )
