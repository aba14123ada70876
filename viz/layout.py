"""How a log is laid out in the viewer. The layout is code, because it is a function of what the log holds."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import rerun.blueprint as rrb

from recorder.topics import CAMERAS, EVENTS, PILOT_COMMAND, PILOT_INPUT, VEHICLE, camera_topic


@dataclass(frozen=True)
class Curve:
    """One line of a plot: a field of the messages on a topic."""

    entity: str
    name: str
    color: tuple[int, int, int]
    topic: str
    field: str


CURVES: Final = (
    Curve("/steering/recorded", "recorded", (120, 160, 255), VEHICLE, "steering"),
    Curve("/steering/predicted", "predicted", (255, 160, 60), PILOT_COMMAND, "predicted_steering"),
    Curve("/steering/sent", "sent", (110, 210, 110), PILOT_COMMAND, "steering"),
    Curve("/speed_mph/driven", "driven", (120, 160, 255), VEHICLE, "speed_mph"),
    Curve("/speed_mph/set", "set", (160, 160, 160), PILOT_COMMAND, "set_speed_mph"),
    Curve("/pedals/throttle", "throttle", (110, 210, 110), VEHICLE, "throttle"),
    Curve("/pedals/brake", "brake", (230, 90, 90), VEHICLE, "brake"),
    Curve("/latency_ms/total", "telemetry to answer", (200, 140, 230), PILOT_COMMAND, "total_ms"),
)


def log_layout(topics: Collection[str]) -> rrb.Blueprint:
    """The layout for a log with these topics; it has no view for what the log does not have."""
    sides = [camera for camera in CAMERAS[1:] if camera_topic(camera) in topics]
    pictures: list[rrb.View | rrb.Container] = []
    if camera_topic("center") in topics:
        pictures.append(rrb.Spatial2DView(origin=camera_topic("center"), name="centre camera"))
    if sides:
        views = [rrb.Spatial2DView(origin=camera_topic(camera), name=f"{camera} camera") for camera in sides]
        pictures.append(rrb.Horizontal(*views))
    if PILOT_INPUT in topics:
        pictures.append(rrb.Spatial2DView(origin=PILOT_INPUT, name="what the network sees"))
    plots: list[rrb.View | rrb.Container] = [
        rrb.TimeSeriesView(
            origin="/steering",
            name="steering, -1 left .. 1 right",
            axis_y=rrb.ScalarAxis(range=(-1.0, 1.0), zoom_lock=True),
        ),
        rrb.TimeSeriesView(origin="/speed_mph", name="speed, mph"),
        rrb.TimeSeriesView(origin="/pedals", name="throttle and brake"),
    ]
    if EVENTS in topics:
        plots.append(rrb.TextLogView(origin=EVENTS, name="events"))
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*pictures), rrb.Vertical(*plots), column_shares=[2, 3]) if pictures else
        rrb.Vertical(*plots),
        rrb.TimePanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )  # fmt: skip
