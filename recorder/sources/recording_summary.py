"""A summary of a recording before its import: its kind, rows and oddities, and the settings that an import
needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from common import Skipped, UserError
from common.errors import counted, printable
from recorder.sources.clean import clean, skip_unread
from recorder.sources.compressed_video import is_video_type
from recorder.sources.csv_recording import csv_in, overview
from recorder.sources.find_recording import FORMAT_NAMES, kind_of
from recorder.sources.mcap_messages import is_picture_type
from recorder.sources.mcap_recording import is_own_log, topics_in
from recorder.sources.recording_kinds import read_recording
from recorder.sources.settings import ImportSettings

_MAX_LISTED: Final = 200  # topics, columns

Needs = Literal["", "topics", "columns"]


@dataclass(frozen=True)
class RecordingSummary:
    """A recording in short. `problem`: why it cannot be imported; "" if none is known."""

    path: Path
    kind: str
    rows: str = ""  # their number, in words; "" if only an import counts them
    oddities: tuple[str, ...] = ()  # parts that an import skips or cannot find
    needs: Needs = ""  # the settings that an import needs
    names: tuple[str, ...] = ()  # the topics or columns to choose from
    pictures: tuple[str, ...] = ()  # the topics with pictures
    is_own: bool = False  # a log of this toolkit, which needs no import
    problem: str = field(default="", compare=False)


def summarize_recording(source: Path) -> RecordingSummary:
    """The summary of a recording that `find_recording` found."""
    try:
        return _summary(source)
    except (UserError, OSError) as error:
        return RecordingSummary(source, "", problem=printable(str(error)))


def _summary(source: Path) -> RecordingSummary:
    skipped = Skipped()
    kind = kind_of(source)
    if kind == "log":
        return _log(source, skipped)
    if not kind:
        return _csv(source)
    settings = ImportSettings()
    recording = read_recording(source, settings, skipped)
    with recording.opened:
        cleaned = clean(recording, settings)
        skip_unread(cleaned, skipped)
    name = FORMAT_NAMES[recording.metadata["source"]]
    if kind == "tub":
        name += f", version {recording.metadata['tub_version']}"
    oddities = (*cleaned.questions, *_lines(skipped))
    return RecordingSummary(source, name, cleaned.summary(), oddities)


def _log(source: Path, skipped: Skipped) -> RecordingSummary:
    if is_own_log(source):
        return RecordingSummary(source, "session of this toolkit", is_own=True)
    types = topics_in(source, skipped)
    format_name = FORMAT_NAMES["ros2 bag" if source.is_dir() else "mcap"]
    has_pictures = [topic for topic, kind in types.items() if is_picture_type(kind) or is_video_type(kind)]
    pictures = tuple(has_pictures[:_MAX_LISTED])
    others = tuple(topic for topic in types if topic not in pictures)[:_MAX_LISTED]
    return RecordingSummary(source, format_name, "", _lines(skipped), "topics", others, pictures)


def _csv(source: Path) -> RecordingSummary:
    names, count = overview(csv_in(source))
    columns = tuple(printable(name) for name in names[:_MAX_LISTED])
    return RecordingSummary(source, FORMAT_NAMES["csv"], counted(count, "row"), needs="columns", names=columns)


def _lines(skipped: Skipped) -> tuple[str, ...]:
    return tuple(skipped.lines(max_names=3))
