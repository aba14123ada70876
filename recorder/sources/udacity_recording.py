"""A folder from the simulator's training mode: `driving_log.csv`, perhaps still growing, and the pictures that its
rows name."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from common.untrusted import open_regular
from recorder.errors import RecordingError, readable
from recorder.log.session_car import UDACITY, Car
from recorder.sources.imported_rows import FROM_1970, RawRecording, recording_metadata
from recorder.sources.picture_folder import PictureFolder
from recorder.sources.udacity_csv import MAX_LINE_BYTES, UTF16_MARKS, RowReader

_MAX_AT_ONCE: Final = 1 << 20


class LineSplitter:
    """Splits bytes at \\n, \\r\\n and \\r, as bytes.splitlines does. Keeps at most a block and a line.

    Longer lines are cut after `MAX_LINE_BYTES` + 1 bytes.
    """

    def __init__(self) -> None:
        self._partial = b""  # a line without an end yet
        self._skips_newline = False  # the last line ended with \r, perhaps the first half of \r\n

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that `data` completes, without their ends."""
        if self._skips_newline and data:
            data = data.removeprefix(b"\n")
            self._skips_newline = False
        if not data:
            return []
        pieces = (self._partial + data).splitlines(keepends=True)
        self._partial = b"" if pieces[-1].endswith((b"\n", b"\r")) else pieces.pop()[: MAX_LINE_BYTES + 1]
        self._skips_newline = not self._partial and pieces[-1].endswith(b"\r")
        return [piece.rstrip(b"\r\n")[: MAX_LINE_BYTES + 1] for piece in pieces]

    def rest(self) -> bytes:
        """The last line, if it has no end; else b"". Call it when nothing more will come."""
        last, self._partial = self._partial, b""
        return last


class CsvTail:
    """The lines of a growing csv. Each call continues where the last one stopped. A csv that was shortened or
    replaced is read again from its start."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.is_behind = False
        """True if the file has more to read: each call reads at most a megabyte."""
        self._file = 0, 0  # its device and number
        self._offset = self._line_count = 0
        self._splitter = LineSplitter()

    def new_lines(self) -> list[tuple[int, bytes]]:
        """The lines completed since the last call, with their numbers in the file, from 1.

        A missing file has no lines. Raises OSError if the file cannot be read now.
        """
        self.is_behind = False
        try:
            with open_regular(self._path) as stream:
                stat = os.fstat(stream.fileno())
                if self._file != (stat.st_dev, stat.st_ino) or stat.st_size < self._offset:
                    self._file = stat.st_dev, stat.st_ino
                    self._offset = self._line_count = 0
                    self._splitter = LineSplitter()
                stream.seek(self._offset)
                data = stream.read(_MAX_AT_ONCE)
        except FileNotFoundError:
            return []
        self.is_behind = len(data) == _MAX_AT_ONCE
        self._offset += len(data)
        return self._numbered(self._splitter.feed(data))

    def rest(self) -> list[tuple[int, bytes]]:
        """The last line, if it has no end. Call it when nothing more will come."""
        content = self._splitter.rest()
        return self._numbered([content] if content else [])

    def _numbered(self, lines: list[bytes]) -> list[tuple[int, bytes]]:
        first = self._line_count + 1
        self._line_count += len(lines)
        return list(enumerate(lines, first))


CSV_NAME: Final = "driving_log.csv"
MAX_CSV_BYTES: Final = 1 << 30  # 200 hours of driving

_BLOCK_BYTES: Final = 1 << 16


def read_udacity(folder: Path, car: Car | None = None) -> RawRecording:
    """The recording in `folder`. Raises RecordingError if there is no csv in it, or it cannot be read."""
    csv = folder / CSV_NAME
    with readable(folder):
        if folder.is_file():
            raise RecordingError(f"{folder}: a file; give the folder that holds {CSV_NAME} and IMG/")
        if not folder.is_dir():
            raise RecordingError(f"{folder}: no such folder; give the folder that holds {CSV_NAME} and IMG/")
        if not csv.is_file():
            raise RecordingError(
                f"{folder}: no {CSV_NAME} in it; give the folder that the simulator recorded into"
            )
        check_csv(folder)
        if not csv.stat().st_size:
            raise RecordingError(f"{csv}: an empty file: no drive was recorded")
        pictures = udacity_pictures(folder)
    reader = RowReader()
    rows = [row for line, content in enumerate(_lines(csv), 1) if (row := reader.read(line, content)) is not None]
    metadata = recording_metadata("udacity", folder, car)
    if reader.is_of_another_calendar:
        metadata |= FROM_1970
    return RawRecording(
        folder,
        metadata,
        rows,
        time_unit="ns",
        mph=(car or UDACITY).mph,
        folder=pictures,
        keeps_rows_without_pictures=True,
        without_rows=f"{csv}: no usable row",
        hint="; if its columns are others, name them with --columns",
    )


def udacity_pictures(folder: Path) -> PictureFolder:
    """The pictures in the first of these folders that has them: IMG/ next to the csv, the csv's folder, ../IMG."""
    root = Path(os.path.realpath(folder))
    return PictureFolder([root / "IMG", root, root.parent / "IMG"])


def _lines(csv: Path) -> Iterator[bytes]:
    splitter = LineSplitter()
    with readable(csv), open_regular(csv) as stream:
        if stream.read(2) in UTF16_MARKS:  # PowerShell's `>` writes it
            stream.seek(0)
            text = io.TextIOWrapper(stream, "utf-16", errors="replace")
            yield from (line.rstrip("\r\n").encode() for line in text)
            return
        stream.seek(0)
        while block := stream.read(_BLOCK_BYTES):
            yield from splitter.feed(block)
    if last := splitter.rest():
        yield last


def check_csv(folder: Path) -> None:
    """Raise RecordingError if the csv in `folder` is a link out of it, or far too large; OSError without a csv."""
    csv = folder / CSV_NAME
    if csv.is_symlink() and not Path(os.path.realpath(csv)).is_relative_to(os.path.realpath(folder)):
        raise RecordingError(
            f"{csv}: a link out of the recording, which is not followed; give a folder of its own"
        )
    if csv.stat().st_size > MAX_CSV_BYTES:
        raise RecordingError(f"{csv}: larger than {MAX_CSV_BYTES / 1e9:.0f} GB, which no drive writes")
