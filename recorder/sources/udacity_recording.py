"""A folder from the simulator's training mode: `driving_log.csv` and the pictures that its rows name."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from common import Skipped
from common.untrusted import open_regular
from recorder.errors import RecordingError, readable
from recorder.sources.csv_lines import LineSplitter
from recorder.sources.udacity_csv import Row, RowReader

CSV_NAME: Final = "driving_log.csv"
MAX_CSV_BYTES: Final = 1 << 30  # 200 hours of driving
MAX_PICTURE_BYTES: Final = 1 << 26
MISSING = "pictures that a row names but no folder has"
WITHOUT_ROW = "pictures without a row"
LINKS = "pictures that are links out of the recording"

_BLOCK_BYTES: Final = 1 << 16


class PictureFiles:
    """The JPEG files of a recording, in the first of these folders that has them: IMG/ next to the csv, the csv's
    folder, ../IMG.

    If one of these folders is a link, it is followed: users may keep the pictures elsewhere. A picture that is a
    link is followed only within these folders: a recording is untrusted.
    """

    def __init__(self, folder: Path, skipped: Skipped) -> None:
        self._folder = folder
        self._skipped = skipped
        self._reported_links = set[str]()

    def places(self) -> list[Path]:
        """The existing folders."""
        return [place for place in self._places() if place.is_dir()]

    def find(self, name: str, places: list[Path]) -> str | None:
        """The path of the picture `name`, in the first of `places` that has it."""
        for place in places:
            path = f"{place}/{name}"
            try:
                mode = os.lstat(path).st_mode
            except (OSError, ValueError):
                continue
            if stat.S_ISREG(mode) or (stat.S_ISLNK(mode) and os.path.isfile(path) and self.is_inside(path)):  # noqa: PTH113
                return path
        return None

    def names_in(self, place: Path) -> Iterator[str]:
        """The pictures in one of the `places`; links that leave the recording are skipped."""
        with os.scandir(place) as entries:
            for entry in entries:
                if not entry.name.lower().endswith((".jpg", ".jpeg")):
                    continue
                if entry.is_symlink() and not self.is_inside(entry.path):
                    self._skip_link(entry.path)
                elif os.path.isfile(entry.path):  # noqa: PTH113  (is_file raises for a link to itself)
                    yield entry.name

    def skip_missing(self, name: str, places: list[Path]) -> None:
        """Skip a named picture that `find` does not find. A link out of the recording counts as such."""
        for place in places:
            path = f"{place}/{name}"
            if os.path.islink(path) and not self.is_inside(path):  # noqa: PTH114
                self._skip_link(path)
                return
        self._skipped.add(MISSING, name)

    def _skip_link(self, path: str) -> None:
        if path not in self._reported_links:
            self._reported_links.add(path)
            self._skipped.add(LINKS, Path(path).name)

    def skip_without_row(self, named: set[str]) -> None:
        """Skip the pictures that no row names, sorted: the order of a folder depends on the disk."""
        names = {name for place in self.places() for name in self.names_in(place) if name not in named}
        for name in sorted(names):
            self._skipped.add(WITHOUT_ROW, name)

    def is_inside(self, path: str) -> bool:
        """True if a picture is in one of the places, after following all links."""
        real = Path(os.path.realpath(path))
        return any(real.is_relative_to(os.path.realpath(place)) for place in self._places())

    def why_none(self) -> str:
        """The probable reason if no picture was found."""
        places = self._places()
        for place in places:
            if place.is_symlink() and not place.exists():
                return f"{place} is a link to {place.readlink()}, which is not there"
        for place in self.places():
            for _ in self.names_in(place):
                pass
        if self._skipped.counts[LINKS]:
            return "its pictures are links out of it, which are not followed; `cp -rL` copies what they name"
        return f"they are expected in IMG/, in {self._folder.name}/ and in ../IMG/"

    def _places(self) -> tuple[Path, Path, Path]:
        root = Path(os.path.realpath(self._folder))
        return root / "IMG", root, root.parent / "IMG"


class UdacityRecording:
    """A recording, read from its first line to its last. Only the pictures' names stay in memory."""

    def __init__(self, folder: Path, skipped: Skipped, rate_hz: float | None = None) -> None:
        """Raises RecordingError if there is no csv in `folder`, or for a rate that no camera has."""
        self.folder = folder
        self.csv = folder / CSV_NAME
        self._skipped = skipped
        self._reader = RowReader(skipped, rate_hz)
        self._files = PictureFiles(folder, skipped)
        with readable(folder):
            if folder.is_file():
                raise RecordingError(f"{folder}: a file; give the folder that holds {CSV_NAME} and IMG/")
            if not folder.is_dir():
                raise RecordingError(f"{folder}: no such folder; give the folder that holds {CSV_NAME} and IMG/")
            if not self.csv.is_file():
                raise RecordingError(
                    f"{folder}: no {CSV_NAME} in it; give the folder that the simulator recorded into"
                )
            check_csv(folder)

    def line_count(self) -> int:
        return sum(1 for _ in self._lines())

    def rows(self) -> Iterator[tuple[Row, tuple[str | None, ...]]]:
        """The usable rows with the paths of their pictures, None for missing ones. Call it once.

        Raises RecordingError at the end if there was no row or no picture.
        """
        row_count = picture_count = 0
        with readable(self.folder):
            places = self._files.places()
            for place in places:
                # if a folder cannot be read, all its pictures would count as missing
                os.scandir(place).close()
        for line, content in enumerate(self._lines(), start=1):
            row = self._reader.read(line, content)
            if row is None:
                continue
            row_count += 1
            paths = tuple(self._files.find(name, places) if name else None for name in row.names)
            picture_count += sum(path is not None for path in paths)
            yield row, paths
            for name, path in zip(row.names, paths, strict=True):
                if name and path is None:
                    self._files.skip_missing(name, places)
        if not row_count:
            if not self.csv.stat().st_size:
                raise RecordingError(f"{self.csv}: an empty file: no drive was recorded")
            why = self._skipped.error_suffix()
            hint = "; if its columns are others, name them with --columns" if why else ""
            raise RecordingError(f"{self.csv}: no usable row{why}{hint}")
        with readable(self.folder):
            if not picture_count:
                raise RecordingError(f"{self.csv}: none of its pictures is there; {self._files.why_none()}")
            self._files.skip_without_row(self._reader.named)

    def _lines(self) -> Iterator[bytes]:
        splitter = LineSplitter()
        with readable(self.csv), open_regular(self.csv) as stream:
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
