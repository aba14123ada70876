"""Every log that is written keeps the rules of MCAP's specification, in both layouts and however it came about."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from recorder import LogWriter
from recorder.bc_pb2 import Prediction
from recorder.upkeep.edit import merge, split, trim
from recorder.upkeep.recover import recover
from tests.helpers.layouts import write_as_before
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.mcap_rules import broken_rules
from tests.helpers.plain_mcap import write_plain
from tests.helpers.udacity import jpeg

ROWS = 40
FOOTER = struct.Struct("<BQQQI")  # opcode, length, summary start, summary offset start, CRC


def session(path: Path, rows: int = ROWS) -> Path:
    return write_log(path, [row / rows for row in range(rows)], lambda _, row: jpeg(100, row) + 5000 * b" ")


def test_sessions_in_both_layouts(tmp_path: Path) -> None:
    path = session(tmp_path / "session.mcap")
    assert broken_rules(path) == []
    assert broken_rules(write_as_before(path, tmp_path / "before.mcap")) == []


def test_a_live_log_with_two_drives_and_logs_made_of_it(tmp_path: Path) -> None:
    live = tmp_path / "live.mcap"
    with LogWriter(live, {"source": "test"}, live=True) as writer:
        writer.event(START_NS, "begin")
        for row in range(ROWS):
            writer.picture("center", START_NS + row * STEP_NS + (row > 20) * 10**10, row, jpeg(row))
            writer.event(START_NS + row * STEP_NS + (row > 20) * 10**10, f"at row {row}")
        writer.event(START_NS + 10**11, "end")
    recorded = session(tmp_path / "session.mcap")
    cut_off = tmp_path / "cut off.mcap"
    cut_off.write_bytes(recorded.read_bytes()[: recorded.stat().st_size // 2])
    made = [live, recover(cut_off, tmp_path / "recovered.mcap").path, tmp_path / "trimmed.mcap"]
    trim(recorded, made[2], (3, 30))
    made += [merge([recorded, recorded], tmp_path / "merged.mcap").path]
    made += [written.path for written in split(made[3], tmp_path)]
    assert {path.name: broken_rules(path) for path in made} == {path.name: [] for path in made}


def test_a_log_without_pictures(tmp_path: Path) -> None:
    path = tmp_path / "predictions.mcap"
    with LogWriter(path, {"source": "prediction"}) as writer:
        for row in range(ROWS):
            writer.prediction("pilot", START_NS + row, row, Prediction(steering=0.5))
    assert broken_rules(path) == []


def test_a_copy_of_another_programs_log(tmp_path: Path) -> None:
    other = write_plain(tmp_path / "other.mcap", CompressionType.ZSTD, range(ROWS))
    assert broken_rules(recover(other, tmp_path / "copy.mcap").path) == []


def mended(data: bytearray) -> bytes:
    """With CRCs of the data section and of the summary that hold."""
    at = len(data) - 8 - FOOTER.size
    _, _, start, _, _ = FOOTER.unpack_from(data, at)
    data[start - 4 : start] = struct.pack("<I", zlib.crc32(data[: start - 13]))
    data[at + FOOTER.size - 4 : at + FOOTER.size] = struct.pack(
        "<I", zlib.crc32(data[start : at + FOOTER.size - 4])
    )
    return bytes(data)


def of_no_rule(data: bytes) -> set[int]:
    """Places of bytes that may be anything: what the header and metadata say; and in chunks, whose CRCs tell."""
    places, position = set[int](), 8
    while position < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, position)
        end = position + 9 + length
        if opcode in (Opcode.HEADER, Opcode.METADATA):
            places |= set(range(position + 9, end))
        elif opcode == Opcode.CHUNK:
            places |= set(range(position + 49, end))
        position = end
    return places


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.long)])
def test_the_rules_are_about_every_byte_but_those_of_free_text(tmp_path: Path, every: int) -> None:
    """Whatever bit is another one, also where no CRC tells it, breaks a rule."""
    path, forged = write_log(tmp_path / "session.mcap", [0.0, 0.5]), tmp_path / "forged.mcap"
    data = path.read_bytes()
    assert mended(bytearray(data)) == data
    summary_start = FOOTER.unpack_from(data, len(data) - 8 - FOOTER.size)[2]
    crcs = {*range(summary_start - 4, summary_start), *range(len(data) - 12, len(data) - 8)}
    unnoticed = []
    for at in sorted({*range(0, len(data), every)} - of_no_rule(data)):
        changed = bytearray(data)
        changed[at] ^= 1 << at % 8
        forged.write_bytes(changed if at in crcs else mended(changed))
        if not broken_rules(forged):
            unnoticed.append(at)
    assert unnoticed == []
