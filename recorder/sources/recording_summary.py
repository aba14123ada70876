"""A summary of a recording before its import: its kind, rows and oddities, and the settings that an import
needs."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final, Literal

from common import Skipped, UserError
from common.errors import counted, printable
from recorder.errors import RecordingError
from recorder.sources.csv_columns import MAX_LINE_CHARACTERS, delimiter_of, open_csv
from recorder.sources.donkeycar_tub import open_tub
from recorder.sources.find_recording import kind_of
from recorder.sources.import_mcap import is_own_log, topics_in
from recorder.sources.lerobot_dataset import open_dataset
from recorder.sources.mcap_messages import is_picture_type
from recorder.sources.udacity_recording import UdacityRecording

MAX_COUNTED_ROWS: Final = 100_000
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
    """The summary of a recording that `find_recording` found. Reads at most `MAX_COUNTED_ROWS` rows."""
    try:
        return _summary(source)
    except (UserError, OSError) as error:
        return RecordingSummary(source, "", problem=printable(str(error)))


def _summary(source: Path) -> RecordingSummary:
    skipped = Skipped()
    kind = kind_of(source)
    if kind == "log":
        return _log(source, skipped)
    if kind == "lerobot":
        dataset = open_dataset(source)
        rows = f"{counted(dataset.frames, 'frame')} in {counted(dataset.episodes, 'episode')}"
        pictures = tuple(dataset.image_keys[:_MAX_LISTED])
        return RecordingSummary(source, "LeRobot dataset", rows, pictures=pictures)
    if kind == "tub":
        tub = open_tub(source, skipped)
        deleted = (f"{counted(len(tub.deleted), 'record')} marked as deleted",) if tub.deleted else ()
        records = counted(tub.count, "record")
        return RecordingSummary(source, f"DonkeyCar tub, version {tub.version}", records, _lines(skipped, deleted))
    return _udacity(source, skipped) if kind == "udacity" else _csv(source)


def _log(source: Path, skipped: Skipped) -> RecordingSummary:
    if is_own_log(source):
        return RecordingSummary(source, "session of this toolkit", is_own=True)
    types = topics_in(source, skipped)
    kind = "ROS 2 bag" if source.is_dir() else "MCAP log of another program"
    pictures = tuple(topic for topic, type_name in types.items() if is_picture_type(type_name))[:_MAX_LISTED]
    others = tuple(topic for topic in types if topic not in pictures)[:_MAX_LISTED]
    return RecordingSummary(source, kind, "", _lines(skipped), "topics", others, pictures)


def _udacity(source: Path, skipped: Skipped) -> RecordingSummary:
    count = sum(1 for _ in islice(UdacityRecording(source, skipped).rows(), MAX_COUNTED_ROWS))
    return RecordingSummary(source, "recording of Udacity's simulator", _rows(count), _lines(skipped))


def _csv(source: Path) -> RecordingSummary:
    try:
        with open_csv(source) as text:
            first = text.readline(MAX_LINE_CHARACTERS)
            lines = iter(lambda: text.readline(MAX_LINE_CHARACTERS), "")
            count = sum(1 for _ in islice(lines, MAX_COUNTED_ROWS))
        names = next(csv.reader([first], delimiter=delimiter_of(first)), [])
    except csv.Error as error:
        raise RecordingError(f"{source}: not a csv ({error})") from None
    columns = tuple(printable(name.strip()) for name in names[:_MAX_LISTED])
    return RecordingSummary(source, "pictures with a csv", _rows(count), needs="columns", names=columns)


def _rows(count: int) -> str:
    return f"{counted(count, 'row')}{' or more' if count == MAX_COUNTED_ROWS else ''}"


def _lines(skipped: Skipped, more: tuple[str, ...] = ()) -> tuple[str, ...]:
    return (*more, *skipped.lines(max_names=3))
