"""The layout for Foxglove shows what a log has: its topics, and fields that its messages have.

Foxglove itself is not tried here; the names of its panels and settings are those of its own SDK.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
from foxglove import layouts
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from common.car import CAMERAS
from recorder import topics
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.topics import camera_topic
from tests.helpers.repository import ROOT

LAYOUT = ROOT / "docs" / "foxglove-layout.json"
SCHEMAS: dict[str, Any] = {
    **{camera_topic(camera): CompressedImage.DESCRIPTOR for camera in CAMERAS},
    topics.PILOT_INPUT: CompressedImage.DESCRIPTOR,
    topics.VEHICLE: VehicleState.DESCRIPTOR,
    topics.PILOT_COMMAND: PilotCommand.DESCRIPTOR,
    topics.EVENTS: LogMessage.DESCRIPTOR,
    topics.POSE: PoseInFrame.DESCRIPTOR,
}
PANELS: dict[str, type] = {
    "Image": layouts.ImageConfig,
    "Plot": layouts.PlotConfig,
    "StateTransitions": layouts.StateTransitionsConfig,
    "RosOut": layouts.LogConfig,
}
TITLE = "foxglovePanelTitle"


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(LAYOUT.read_text(encoding="utf-8"))
    return content


def texts(value: object) -> Iterator[str]:
    """Every text in it, however deep."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for inner in value.values():
            yield from texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from texts(inner)


def named(layout: dict[str, Any]) -> set[str]:
    """The topics and message paths that its panels name."""
    return {text for text in texts(layout["configById"]) if text.startswith("/")}


def settings_of(kind: type) -> set[str]:
    """The settings of a panel, or of a line of its, as its JSON calls them."""
    names = {field.name for field in dataclasses.fields(kind)}
    return {re.sub(r"_(\w)", lambda match: match[1].upper(), name) for name in names}


def test_every_message_path_leads_to_a_number_or_a_word_of_our_messages(layout: dict[str, Any]) -> None:
    paths = named(layout) - SCHEMAS.keys()
    assert len(paths) > 10
    for path in paths:
        topic, *names = path.split(".")
        message = SCHEMAS[topic]
        for name in names:
            assert name in message.fields_by_name, path
            message = message.fields_by_name[name].message_type
        assert message is None, path  # a message has fields, a number has none


def test_it_shows_every_topic_and_every_number_of_our_messages(layout: dict[str, Any]) -> None:
    shown = named(layout)
    assert {path.split(".")[0] for path in shown} == SCHEMAS.keys()
    for topic in (topics.VEHICLE, topics.PILOT_COMMAND):
        numbers = {field.name for field in SCHEMAS[topic].fields} - {"not_recorded_s"}  # a row of many has it
        assert {f"{topic}.{name}" for name in numbers} <= shown


def test_pictures_and_events_are_given_to_panels_that_show_them(layout: dict[str, Any]) -> None:
    panels = layout["configById"]
    pictures = {panel["imageMode"]["imageTopic"] for name, panel in panels.items() if name.startswith("Image!")}
    assert pictures == {topic for topic, schema in SCHEMAS.items() if schema is CompressedImage.DESCRIPTOR}
    logs = {panel["topicToRender"] for name, panel in panels.items() if name.startswith("RosOut!")}
    assert logs == {topic for topic, schema in SCHEMAS.items() if schema is LogMessage.DESCRIPTOR}


def test_panels_have_settings_that_foxgloves_sdk_knows(layout: dict[str, Any]) -> None:
    for name, panel in layout["configById"].items():
        kind = PANELS[name.split("!")[0]]
        assert panel.keys() - {TITLE} <= settings_of(kind), name
        assert panel.get("imageMode", {}).keys() <= settings_of(layouts.ImageModeConfig)
        line = layouts.StateTransitionsSeries if kind is layouts.StateTransitionsConfig else layouts.PlotSeries
        for path in panel.get("paths", []):
            assert path.keys() <= settings_of(line), name
            assert path["enabled"] is True  # one that is left out is not drawn
