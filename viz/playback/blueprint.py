"""How a log is laid out in the viewer. The layout is code, because it is a function of what the log holds."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from common.car import CAMERAS
from recorder.bc_pb2 import PilotCommand
from recorder.log.topics import EVENTS, PILOT_COMMAND, PILOT_INPUT, POSE, PREDICTIONS, VEHICLE, camera_topic
from viz.timelines import SINCE_START

AROUND_S: Final = 1.0
"""So long before and after the moment that is asked for is played, where the time cursor cannot be set."""

ERRORS: Final = "/error_deg"
DRIVER: Final = "/driver"
HISTOGRAM: Final = "/histogram/recorded"
PATH: Final = "/path/driven"
CAR: Final = "/path/car"
SPEED: Final = "/speed_mph/driven"

Color = tuple[int, int, int]
Part = rrb.View | rrb.Container
Shared = tuple[Part, float]
"""A part, and its share of the height."""

BLUE: Final = (120, 160, 255)
ORANGE: Final = (255, 160, 60)
GREEN: Final = (110, 210, 110)
VIOLET: Final = (200, 140, 230)
GREY: Final = (160, 160, 160)
RED: Final = (230, 90, 90)

DRIVERS: Final[Mapping[int, tuple[str, Color]]] = {
    PilotCommand.UNKNOWN: ("unknown", GREY),
    PilotCommand.PILOT: ("pilot", GREEN),
    PilotCommand.HUMAN: ("human", ORANGE),
    PilotCommand.EXPERT: ("expert", BLUE),
    PilotCommand.BRAKE: ("brake", RED),
}
"""Who drives: name and colour."""

LOG_COLORS: Final = (BLUE, ORANGE, GREEN, VIOLET, RED, GREY)
"""Of logs beside each other."""

STEERING: Final = "steering, -1 left .. 1 right"
WHO: Final = "who drives"
ERROR: Final = "error in degrees: predicted - recorded"
_SHARES: Final = {WHO: 0.9, STEERING: 2.0}  # of the height; the others have 1.0 each
_FRAME_SHARE: Final = 3.0  # of the height, where logs are beside each other


@dataclass(frozen=True)
class Curve:
    """One line of a plot: a field of the messages on a topic."""

    entity: str
    name: str
    color: Color
    topic: str
    field: str
    is_optional: bool = False  # messages may lack it


CURVES: Final = (
    Curve("/steering/recorded", "recorded", BLUE, VEHICLE, "steering"),
    Curve("/steering/predicted", "predicted", ORANGE, PILOT_COMMAND, "predicted_steering"),
    Curve("/steering/sent", "sent", GREEN, PILOT_COMMAND, "steering"),
    Curve("/steering/expert", "expert", VIOLET, PILOT_COMMAND, "expert_steering", is_optional=True),
    Curve(SPEED, "driven", BLUE, VEHICLE, "speed_mph"),
    Curve("/speed_mph/set", "set", GREY, PILOT_COMMAND, "set_speed_mph"),
    Curve("/pedals/throttle", "throttle", GREEN, VEHICLE, "throttle"),
    Curve("/pedals/brake", "brake", RED, VEHICLE, "brake"),
    Curve("/pedals/sent", "throttle sent", ORANGE, PILOT_COMMAND, "throttle"),
    Curve("/latency_ms/total", "telemetry to answer", VIOLET, PILOT_COMMAND, "total_ms"),
    Curve("/latency_ms/network", "network", ORANGE, PILOT_COMMAND, "network_ms"),
    Curve("/latency_ms/decode", "JPEG and crop", BLUE, PILOT_COMMAND, "decode_ms"),
    Curve("/latency_ms/parse", "reading the message", GREY, PILOT_COMMAND, "parse_ms"),
)
ARCS: Final[Mapping[str, float]] = {"/steering/recorded": 2.5, "/steering/predicted": 2.0, "/steering/sent": 1.5}
"""Steering that is also drawn over the frame, and half its width there."""


def log_layout(
    topics: Collection[str],
    runs: Sequence[str] = (),
    attention: Sequence[str] = (),
    *,
    grows: bool = False,
    at_s: float | None = None,
) -> rrb.Blueprint:
    """The layout for a log with these topics; it has no view for what the log does not have.

    `runs` are the names of those whose predictions are shown beside it, `attention` of those that show where they
    look. A log that grows is followed; another one opens at its start, or `at_s` seconds after it.
    """
    looks = [rrb.Spatial2DView(origin=attention_entity(run), name=f"where {run} looks") for run in attention]
    plots = _plots(topics, has_errors=bool(runs) or _has_predictions(topics))
    if runs or EVENTS in topics or not topics:
        plots.append((rrb.TextLogView(origin=EVENTS, name="events"), 1.0))
    parts = _side_by_side([_pictures(topics, looks), _upright(plots)], shares=[2, 3])
    return _blueprint(parts, _time_panel(SINCE_START, grows=grows, at_s=at_s))


def comparison_layout(
    logs: Mapping[str, Collection[str]], timeline: str, *, at_s: float | None = None
) -> rrb.Blueprint:
    """The layout for several logs beside each other, on `timeline`: the topics of each, by its name. It opens at
    their start, or `at_s` seconds after it."""
    columns = [_of_one(name, topics) for name, topics in logs.items()]
    together: list[Part] = []
    with_states = [name for name, topics in logs.items() if {VEHICLE, PILOT_COMMAND} & set(topics)]
    with_poses = [name for name, topics in logs.items() if POSE in topics]
    if with_states:
        driven = [log_entity(name) + SPEED for name in with_states]
        together.append(rrb.TimeSeriesView(origin="/", contents=driven, name="speed, mph"))
    if with_poses:
        ways = [f"{log_entity(name)}/path/**" for name in with_poses]
        together.append(rrb.Spatial2DView(origin="/", contents=ways, name="paths from above, m"))
    rows = [rrb.Horizontal(*columns), *([rrb.Horizontal(*together)] if together else [])]
    return _blueprint(rrb.Vertical(*rows, row_shares=[3, 1][: len(rows)]), _time_panel(timeline, at_s=at_s))


def attention_entity(run: str) -> str:
    """Where it is shown where a run's network looks."""
    return f"/attention/{entity_part(run)}"


def log_entity(name: str) -> str:
    """Where all of one of several logs stands."""
    return f"/{entity_part(name)}"


def entity_part(name: str) -> str:
    """Any name as a part of an entity's path."""
    return rr.escape_entity_path_part(name)


def _pictures(topics: Collection[str], looks: Sequence[rrb.View]) -> Part | None:
    parts: list[Shared] = []
    if camera_topic("center") in topics:
        parts.append((rrb.Spatial2DView(origin=camera_topic("center"), name="centre camera"), 3.0))
    sides = [camera for camera in CAMERAS[1:] if camera_topic(camera) in topics]
    if sides:
        views = [rrb.Spatial2DView(origin=camera_topic(camera), name=f"{camera} camera") for camera in sides]
        parts.append((rrb.Horizontal(*views), 1.5))
    small: list[Part] = []
    if PILOT_INPUT in topics:
        small.append(rrb.Spatial2DView(origin=PILOT_INPUT, name="what the network sees"))
    small.extend(looks)
    if POSE in topics:
        small.append(rrb.Spatial2DView(origin="/path", name="path from above, m"))
    if small:
        parts.append((rrb.Grid(*small, grid_columns=min(2, len(small))), 2.0 if len(small) <= 2 else 4.0))
    return _upright(parts)


def _plots(topics: Collection[str], *, has_errors: bool) -> list[Shared]:
    """The plots of a log with these topics."""
    has_states = VEHICLE in topics or PILOT_COMMAND in topics
    plots = _driving(topics, "", "", has_steering=has_states or has_errors)
    if has_errors:
        plots.append((rrb.TimeSeriesView(origin=ERRORS, name=ERROR), 1.0))
    if has_states:
        plots.append((rrb.TimeSeriesView(origin="/speed_mph", name="speed, mph"), 1.0))
        plots.append((rrb.TimeSeriesView(origin="/pedals", name="throttle and brake"), 1.0))
    if PILOT_COMMAND in topics:
        plots.append((rrb.TimeSeriesView(origin="/latency_ms", name="latency, ms"), 1.0))
    if VEHICLE in topics:
        plots.append((rrb.BarChartView(origin="/histogram", name="frames by steering, 25 bins"), 1.0))
    return plots


def _driving(topics: Collection[str], at: str, of: str, *, has_steering: bool) -> list[Shared]:
    """Who drives, and the steering; entities begin with `at`, names of views with `of`."""
    plots: list[Shared] = []
    if PILOT_COMMAND in topics:
        plots.append((rrb.StateTimelineView(origin=at + DRIVER, name=of + WHO), _SHARES[WHO]))
    if has_steering:
        axis = rrb.ScalarAxis(range=(-1.0, 1.0), zoom_lock=True)
        view = rrb.TimeSeriesView(origin=f"{at}/steering", name=of + STEERING, axis_y=axis)
        plots.append((view, _SHARES[STEERING]))
    return plots


def _of_one(name: str, topics: Collection[str]) -> rrb.Container:
    """The column of one of several logs."""
    at, of = log_entity(name), f"{name}: "
    frames: list[Part] = []
    if camera_topic("center") in topics:
        frames.append(rrb.Spatial2DView(origin=at + camera_topic("center"), name=f"{of}centre camera"))
    if PILOT_INPUT in topics:
        frames.append(rrb.Spatial2DView(origin=at + PILOT_INPUT, name=f"{of}what the network sees"))
    parts: list[Shared] = [(_side_by_side(frames, shares=[2, 1][: len(frames)]), _FRAME_SHARE)] if frames else []
    has_states = VEHICLE in topics or PILOT_COMMAND in topics
    has_predictions = _has_predictions(topics)
    parts += _driving(topics, at, of, has_steering=has_states or has_predictions)
    if has_predictions:
        parts.append((rrb.TimeSeriesView(origin=at + ERRORS, name=of + ERROR), 1.0))
    if EVENTS in topics or not parts:
        parts.append((rrb.TextLogView(origin=at + EVENTS, name=f"{of}events"), 1.0))
    return rrb.Vertical(*(part for part, _ in parts), row_shares=[share for _, share in parts], name=name)


def _has_predictions(topics: Collection[str]) -> bool:
    return any(topic.startswith(PREDICTIONS) for topic in topics)


def _upright(parts: Sequence[Shared]) -> Part | None:
    """One above the other."""
    if not parts:
        return None
    return rrb.Vertical(*(part for part, _ in parts), row_shares=[share for _, share in parts])


def _side_by_side(parts: Sequence[Part | None], shares: Sequence[float]) -> Part:
    there = [(part, share) for part, share in zip(parts, shares, strict=True) if part is not None]
    return rrb.Horizontal(*(part for part, _ in there), column_shares=[share for _, share in there])


def _time_panel(timeline: str, *, grows: bool = False, at_s: float | None = None) -> rrb.TimePanel:
    """A layout cannot tell where the time cursor stands, only what is played over and over."""
    if at_s is None:
        return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following" if grows else "paused")
    around = AbsoluteTimeRange(min=round(1e9 * max(0.0, at_s - AROUND_S)), max=round(1e9 * (at_s + AROUND_S)))
    return rrb.TimePanel(
        state="collapsed", timeline=timeline, play_state="playing", loop_mode="selection", time_selection=around
    )


def _blueprint(parts: Part, time_panel: rrb.TimePanel) -> rrb.Blueprint:
    return rrb.Blueprint(
        parts,
        time_panel,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
