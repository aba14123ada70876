"""Follows a Udacity recording while the simulator writes it.

The simulator appends rows during a drive, and renders their pictures one by one after it. Another drive may
follow. A row is logged as soon as its line is complete. A picture is logged as soon as its file is whole, with the
time and the number of its row.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Final

from common.car import Camera
from common.errors import counted
from common.interrupts import stop_signals
from common.progress import StatusLine
from common.untrusted import read_bounded
from recorder.errors import RecordingError
from recorder.log.session_car import UDACITY, Car
from recorder.log.writer import LogWriter
from recorder.pictures.picture_size import is_whole_picture
from recorder.sources.clean import MAX_PICTURE_BYTES, NOT_WHOLE, REPEATED_ROWS, UNREADABLE, names_of, state_of
from recorder.sources.find_recording import is_udacity, recordings_near
from recorder.sources.imported_rows import FROM_1970, Imported, RecordedRow, SkippedEvents, recording_metadata
from recorder.sources.picture_folder import WITHOUT_ROW
from recorder.sources.settings import check_rate, describe_clock
from recorder.sources.udacity_csv import RowReader
from recorder.sources.udacity_recording import CSV_NAME, CsvTail, check_csv, udacity_pictures

WITHOUT_TIME: Final = "rows with no time in their pictures' names (--rate 20 takes them as 20 a second)"
POLL_S: Final = 0.25
_PICTURES_A_ROUND: Final = 1000  # searched between two checks for signals and new rows


def watch_udacity(
    folder: Path,
    log: Path,
    *,
    rate_hz: float | None = None,
    idle_s: float | None = None,
    car: Car | None = None,
    overwrite: bool = False,
    on_started: Callable[[Path], None] | None = None,
) -> Imported:
    """Write the recording in `folder` to `log` while it grows. The folder and its csv may not exist yet.

    Ends on Ctrl-C or `kill`, or `idle_s` after the last new row or picture. In other threads than the main thread,
    signals do not arrive. `on_started` gets the path of the growing file. Else as `import_udacity`.
    """
    check_rate(rate_hz)
    metadata = recording_metadata("udacity", folder, car)
    if rate_hz is not None:
        metadata |= {"clock": describe_clock(rate_hz), **FROM_1970}
    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"{folder}: is a file; give the folder of {CSV_NAME}, which may not exist yet")
    with (
        stop_signals() as stopped,
        LogWriter(log, metadata, overwrite=overwrite, live=True) as writer,
        StatusLine() as status,
    ):
        recording = _GrowingRecording(folder, writer, rate_hz, car)
        if on_started is not None:
            on_started(writer.part)
        if not is_udacity(folder):
            hint = recordings_near(folder)
            waiting = f"waiting for {folder / CSV_NAME}"
            status.show_or_print(f"{waiting};{hint}" if hint else waiting)
        while not stopped.is_set():
            is_busy = recording.poll()
            writer.flush_if_due()
            status.show(recording.status())
            if is_busy:
                continue
            if idle_s is not None and recording.idle_s() >= idle_s:
                break
            stopped.wait(POLL_S)
        recording.finish()
        if not recording.rows:
            raise RecordingError(recording.why_nothing())
    return Imported(log, recording.rows, recording.pictures, recording.skipped, writer.notices)


class _GrowingRecording:
    """A growing recording: the counts of its log, and the pictures that are still awaited."""

    def __init__(self, folder: Path, writer: LogWriter, rate_hz: float | None, car: Car | None) -> None:
        self._mph = (car or UDACITY).mph
        self.rows = 0
        self.pictures = 0
        self._events = SkippedEvents()
        self.skipped = self._events.skipped
        self._folder = folder
        self._writer = writer
        self._csv = CsvTail(folder / CSV_NAME)
        self._reader = RowReader()
        self._rate_hz = rate_hz
        self._files = udacity_pictures(folder)
        self._found = set[str]()  # paths of pictures
        self._of_unusable_rows = set[str]()  # names of pictures
        self._earlier = set[tuple[str, ...]]()  # names of the pictures of each row
        self._awaited: dict[str, list[tuple[Camera, int, int]]] = {}  # file name -> camera, sequence, time
        self._last_ns = 0
        self._last_s: float | None = None

    def poll(self) -> bool:
        """Log new rows and pictures; True if there is more to do at once."""
        with contextlib.suppress(OSError):
            check_csv(self._folder)
        self._take_rows(self._new_lines())
        is_any_new = self._take_pictures(list(islice(self._awaited, _PICTURES_A_ROUND)))
        return is_any_new or self._csv.is_behind

    def finish(self) -> None:
        """Log everything left, and count missing pictures."""
        self._take_rows(self._new_lines())
        while self._csv.is_behind:
            self._take_rows(self._new_lines())
        self._take_rows(self._csv.rest())
        self._take_pictures(list(self._awaited))
        for name, uses in self._awaited.items():
            for _, _, time_ns in uses:
                self._events.time_ns = time_ns
                self._skip(name)
        if self.rows:
            self._events.time_ns = self._last_ns
        found = self._found | {path for name in self._of_unusable_rows if (path := self._files.find(name))}
        for name in self._files.without_row(found):
            self.skipped.add(WITHOUT_ROW, name)

    def idle_s(self) -> float:
        """Seconds since the last row or picture; 0 before the first."""
        return 0.0 if self._last_s is None else time.monotonic() - self._last_s

    def status(self) -> str:
        if not self.rows and not is_udacity(self._folder):
            return f"waiting for {self._folder / CSV_NAME}"
        return (
            f"{counted(self.rows, 'row')}, {counted(self.pictures, 'picture')},"
            f" {self._writer.bytes_written / 1e6:,.1f} MB, waiting for"
            f" {counted(len(self._awaited), 'picture')}, {len(self.skipped):,} skipped"
        )

    def why_nothing(self) -> str:
        csv = self._folder / CSV_NAME
        if not is_udacity(self._folder):
            return f"{csv}: it never came; give the folder that the simulator's training mode records into"
        return f"{csv}: no usable row{self.skipped.error_suffix()}"

    def _new_lines(self) -> list[tuple[int, bytes]]:
        with contextlib.suppress(OSError):  # if the csv cannot be read now, the next call reads it
            return self._csv.new_lines()
        return []

    def _take_rows(self, lines: list[tuple[int, bytes]]) -> None:
        for line, content in lines:
            self._last_s = time.monotonic()
            row = self._reader.read(line, content)
            if row is None:
                continue
            names = names_of(row)
            problem = row.problem or (REPEATED_ROWS if names in self._earlier else "")
            self._earlier.add(names)
            if problem or (time_ns := self._time_ns(row)) is None:
                self.skipped.add(problem or WITHOUT_TIME, row.name)
                self._of_unusable_rows.update(names)
                continue
            self._last_ns = time_ns
            if not self.rows:
                self._events.write_to(self._writer, time_ns)
            self._events.time_ns = time_ns
            self._writer.vehicle(time_ns, self.rows, state_of(row, self._mph))
            for camera, name in zip(row.pictures, names, strict=True):
                self._awaited.setdefault(name, []).append((camera, self.rows, time_ns))
            self.rows += 1

    def _time_ns(self, row: RecordedRow) -> int | None:
        if self._rate_hz is None:
            return None if row.time is None else int(row.time)
        if row.time is not None:
            raise RecordingError("--rate: the pictures' names have their times; leave it out")
        return round((row.position or 0) * 1e9 / self._rate_hz)

    def _take_pictures(self, names: list[str]) -> bool:
        """Log the whole pictures among these awaited ones; the others go to the end of the queue. True if any was
        logged."""
        if names:
            with contextlib.suppress(OSError, RecordingError):
                self._files.refresh()
        pictures = self.pictures
        for name in names:
            uses = self._awaited.pop(name)
            path = self._files.find(name)
            jpeg = None if path is None else self._read(path)
            if jpeg is None or not is_whole_picture(jpeg):
                self._awaited[name] = uses
                continue
            self._last_s = time.monotonic()
            self._found.add(str(path))
            for camera, sequence, time_ns in uses:
                self._writer.picture(camera, time_ns, sequence, jpeg)
                self.pictures += 1
        return self.pictures > pictures

    def _skip(self, name: str) -> None:
        """Count an awaited picture as skipped, with the reason."""
        path = self._files.find(name)
        if path is None:
            self._files.skip_missing(name, self.skipped)
        else:
            self._found.add(path)
            self.skipped.add(UNREADABLE if self._read(path) is None else NOT_WHOLE, name)

    def _read(self, path: str) -> bytes | None:
        """The bytes of a picture; None if it cannot be read now."""
        try:
            return read_bounded(path, MAX_PICTURE_BYTES)
        except OSError:
            return None
