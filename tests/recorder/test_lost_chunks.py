"""What a lost chunk costs where pictures have chunks of their own: a chunk of rows costs these rows, and their
pictures with them; a chunk of pictures costs no row. All of it is told by its numbers, and the rest is sound.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from common.car import CAMERAS
from recorder import Log, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.topics import PICTURE_TOPICS, ROW_TOPICS
from recorder.upkeep.check import check
from recorder.upkeep.derived_log import Written
from recorder.upkeep.recover import recover
from tests.helpers.logs import START_NS, STEP_NS, not_a_picture
from tests.helpers.plain_mcap import Contents, Stored, StoredChunk, by_topic, contents

ROWS = 60
MISSING = "stretches of rows that are missing"
WITHOUT_PICTURE = "stretches of rows without a picture"
REST_LOST = "messages of a row whose other parts are lost"


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 1024)


def drive(path: Path, first: int = 0) -> Path:
    """A drive with events and crops; chunks of pictures are of about two rows, others of about eight."""
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(first, first + ROWS):
            time_ns = START_NS + row * STEP_NS
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, not_a_picture(camera, row) * 8)
            writer.vehicle(time_ns, row, VehicleState(steering=row % 1000 / 1000, throttle=0.5, speed_mph=9.0))
            writer.crop(time_ns, row, b"\x89PNG\r\n\x1a\n" + bytes([row % 256]))
            writer.command(time_ns, row, PilotCommand(steering=row % 1000 / 500))
            if row % 7 == 0:
                writer.event(time_ns, f"at row {row}")
    return path


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    return drive(tmp_path / "whole.mcap", first=1000)


def is_of_pictures(chunk: StoredChunk) -> bool:
    return chunk.messages[0].topic in PICTURE_TOPICS


def behind_descriptions(chunks: list[StoredChunk]) -> list[StoredChunk]:
    """Those behind the first message of every topic: nothing else describes the topic in a killed log."""
    firsts: dict[str, int] = {}
    for number, chunk in enumerate(chunks):
        for message in chunk.messages:
            firsts.setdefault(message.topic, number)
    return chunks[max(firsts.values()) + 1 :]


def driven(messages: list[Stored]) -> set[int]:
    return {message.sequence for message in messages if message.topic == "/vehicle"}


def without(path: Path, lost: list[StoredChunk], *, is_killed: bool = False) -> Path:
    """A copy in which these chunks are zeros: what a failing disk, or a pulled plug, leaves."""
    data = bytearray(path.read_bytes())
    for chunk in lost:
        data[chunk.start : chunk.end] = bytes(chunk.end - chunk.start)
    damaged = path.with_name("damaged.mcap")
    damaged.write_bytes(data[: contents(path).chunks[-1].end] if is_killed else data)
    return damaged


def expected(original: Contents, lost: list[StoredChunk]) -> tuple[list[Stored], set[int]]:
    """What is whole and has its row; and the rows that are gone."""
    left = [message for chunk in original.chunks if chunk not in lost for message in chunk.messages]
    rows = driven(left)
    gone = driven(original.messages) - rows
    return [m for m in left if m.topic not in ROW_TOPICS or m.sequence in rows], gone


def numbers(written: Written, reason: str, topic: str = "") -> set[int]:
    """The rows that are named for a reason."""
    rows: set[int] = set()
    for why, where in written.skipped:
        if why == reason and where.startswith(topic):
            words = where.split()
            rows.update(range(int(words[words.index("rows") + 1]), int(words[-1]) + 1) if "rows" in words else ())
            rows.update([int(words[-1])] if "row" in words else ())
    return rows


def complaints_of(whole: Path, lost: list[StoredChunk], *, is_killed: bool = False) -> Iterator[str]:
    original = contents(whole)
    left, gone = expected(original, lost)
    to = whole.with_name("recovered.mcap")
    damaged = without(whole, lost, is_killed=is_killed)
    with Log(damaged) as log:
        if is_killed and original.chunks[-1] not in lost and "bytes before it are damaged" not in log.notice:
            yield log.notice
    written = recover(damaged, to, overwrite=True)
    content = contents(to)
    if content.by_topic != by_topic(left):
        yield f"{len(content.messages)} messages, not {len(left)}"
    hit = [m for chunk in original.chunks if chunk not in lost for m in chunk.messages if m not in left]
    last = (
        max(driven(left)) if is_killed else max(m.sequence for m in [*left, *hit])
    )  # of the rest, nothing is left
    if numbers(written, MISSING) != {row for row in gone if row <= last}:
        yield f"named as missing: {sorted(numbers(written, MISSING))}, not {sorted(gone)}"
    reported = numbers(written, REST_LOST) | numbers(written, "messages of a row that was never finished")
    if reported != {m.sequence for m in hit}:
        yield f"named as torn: {sorted(reported)}"
    kept, findings = driven(left), check(to, look=False).findings
    for topic in sorted(PICTURE_TOPICS & original.by_topic.keys()):
        dark = kept - {m.sequence for m in left if m.topic == topic}
        if numbers(written, WITHOUT_PICTURE, topic) != dark:
            yield f"{topic}: named {sorted(numbers(written, WITHOUT_PICTURE, topic))}, not {sorted(dark)}"
        if topic.startswith("/camera/"):
            of_check = {where for kind, where in findings if kind == WITHOUT_PICTURE}
            of_recover = {where for why, where in written.skipped if why == WITHOUT_PICTURE and "camera" in where}
            if of_check != of_recover:
                yield f"check: {of_check}, recover: {of_recover}"
    others = {kind for kind, _ in findings} - {WITHOUT_PICTURE, "gaps in time"}
    if others:
        yield f"check: {others}"


@pytest.mark.parametrize("is_killed", [False, True], ids=["finished", "killed"])
def test_whatever_chunk_is_lost_costs_no_more_than_it_must(whole: Path, is_killed: bool) -> None:
    chunks = contents(whole).chunks
    assert sum(map(is_of_pictures, chunks)) > 20
    assert len(chunks) - sum(map(is_of_pictures, chunks)) > 5
    complaints = [
        f"chunk {chunks.index(chunk)}: {complaint}"
        for chunk in (behind_descriptions(chunks) if is_killed else chunks)
        for complaint in complaints_of(whole, [chunk], is_killed=is_killed)
    ]
    assert complaints == []


def test_without_any_row_the_pictures_are_kept_and_the_rows_are_named(whole: Path) -> None:
    """Pictures are worth something, and there is nothing else."""
    original = contents(whole)
    lost = [chunk for chunk in original.chunks if not is_of_pictures(chunk)]
    written = recover(without(whole, lost), whole.with_name("recovered.mcap"))
    content = contents(written.path)
    assert content.by_topic == by_topic(
        m for chunk in original.chunks if chunk not in lost for m in chunk.messages
    )
    assert numbers(written, MISSING) == driven(original.messages)
    damaged, count = whole.with_name("damaged.mcap"), len(original.messages)
    assert written.notices == [
        f"{damaged}: lost in all: {count - len(content.messages):,} of {count:,} messages",
        f"{damaged}: no complete row in it: the new log has no rows",
    ]
    kinds = {kind for kind, _ in check(written.path, look=False).findings}
    assert kinds == {"stretches of pictures without a row"}
