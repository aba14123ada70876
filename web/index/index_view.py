"""The data of the index's page: settings, bins, each session's frames, and the split along time;
and the folders in which settings are tried."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.errors import printable
from common.stretches import stretches
from common.untrusted import real_path
from dataset.errors import DatasetError
from dataset.frames.frames_file import read_frames
from dataset.frames.image_check_cache import IMAGE_CHECKS_FOLDER
from dataset.index.build_state import FRAMES_FOLDER
from dataset.parquet_file import read_columns, read_metadata
from dataset.samples.samples_format import (
    READABLE_FORMATS,
    SAMPLES_FORMAT,
    SAMPLES_NAME,
    Balance,
    SessionCounts,
)
from dataset.steering_bins import BINS, bin_of
from web.errors import or_404
from web.logs.film_strip import bars, root_heights, svg

_KEPT: Final = 4


class IndexTrials:
    """The newest trials. The folder may be deleted at any time."""

    def __init__(self, cache: Path) -> None:
        self._folder = cache / "trials"

    def new(self, index: Path) -> tuple[str, Path]:
        """A name and a folder for a trial. The folder gets the index's checks of pictures, which take long."""
        trials = sorted(self._trials().values(), key=lambda path: path.stat().st_mtime_ns)
        for path in trials[: max(0, len(trials) + 1 - _KEPT)]:
            shutil.rmtree(path, ignore_errors=True)
        folder = self._folder / secrets.token_hex(6)
        folder.mkdir(parents=True)
        with contextlib.suppress(OSError, shutil.Error):
            shutil.copytree(index / IMAGE_CHECKS_FOLDER, folder / IMAGE_CHECKS_FOLDER)
        return folder.name, folder

    def get(self, key: str) -> Path:
        """The folder of a trial. Raises WebError if it does not exist (any more)."""
        reason = f"no trial {key!r}: only the newest {_KEPT} are kept; try the settings again"
        return real_path(or_404(self._trials().get(key), reason))

    def _trials(self) -> dict[str, Path]:
        return {path.name: path for path in self._folder.glob("*")}


_WIDTH: Final = 300
_COLORS: Final = {"train": "#4a90d9", "validation": "#c77d1e"}  # readable on a light and on a dark page
_BEFORE, _AFTER, _OTHER, _AXIS = "#8d97a1", "#4a90d9", "#8885", "#8884"


@dataclass(frozen=True)
class IndexView:
    """An index, by the metadata of its samples.parquet."""

    settings: dict[str, str]
    before: list[int]  # training samples of each steering bin before balancing
    after: list[int]  # and after balancing
    counts: dict[str, dict[str, int]]  # frames of each session by their use

    @property
    def frames(self) -> int:
        return sum(counts.get("frames", 0) for counts in self.counts.values())

    @property
    def ways(self) -> list[str]:
        """The uses (training, held out ...) that any frame has, in the order of `bc-index`."""
        order = [field.name for field in fields(SessionCounts)]
        ways = dict.fromkeys(way for counts in self.counts.values() for way, count in counts.items() if count)
        return sorted(ways, key=lambda way: order.index(way) if way in order else len(order))


def view_index(index: Path) -> IndexView:
    """The index in a folder. Raises DatasetError if it is missing, damaged, or of another version."""
    path = index / SAMPLES_NAME
    metadata = read_metadata(path)
    if metadata is None:
        raise DatasetError(f"{path}: missing or damaged; `bc-index` builds it")
    if (version := metadata.get("format")) not in READABLE_FORMATS:
        raise DatasetError(
            f"{path}: of format {printable(str(version))}, not {SAMPLES_FORMAT}; `bc-index` builds it anew"
        )
    try:
        balance = Balance.from_dict(metadata["balance"])
        return IndexView(
            {printable(str(name)): _text(value) for name, value in metadata["settings"].items()},
            balance.before.tolist(),
            balance.after.tolist(),
            {
                str(session): {printable(str(way)): int(count) for way, count in counts.items()}
                for session, counts in metadata["counts"].items()
            },
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DatasetError(f"{path}: invalid metadata ({error}); `bc-index` builds it anew") from None


def bins_sketch(view: IndexView) -> bytes:
    """The bins before (behind) and after balancing, from left to right, as an SVG."""
    height = 120
    top = max([1, *view.before, *view.after])

    def path(counts: list[int], color: str, share: float) -> str:
        heights = [height * count / top for count in counts]
        return f'<path d="{bars(heights, 0, 2 * _WIDTH, height, share)}" fill="{color}"/>'

    paths = [path(view.before, _BEFORE, 0.9), path(view.after, _AFTER, 0.5)]
    return _svg(2 * _WIDTH, height, [*paths, f'<path d="M{_WIDTH} 0V{height}" stroke="{_AXIS}"/>'])


def session_bins_sketch(index: Path, session: str) -> bytes:
    """The square roots of a session's training samples in each steering bin of the index, as an SVG. Raises
    DatasetError as `view_index` does."""
    height, bins = 28, len(view_index(index).before)
    filters = [("session", "=", session), ("split", "=", "train")]
    try:
        labels = read_columns(index / SAMPLES_NAME, ["label"], filters=filters)["label"].to_numpy()
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise DatasetError(f"{index / SAMPLES_NAME}: unreadable ({error}); `bc-index` builds it anew") from None
    counts = np.bincount(bin_of(labels, bins), minlength=bins)
    path = bars(root_heights(counts, height), 0, _WIDTH, height)
    return _svg(_WIDTH, height, [f'<path d="{path}" fill="{_AFTER}"/>'])


def bins_of_index(index: Path) -> int:
    """The number of steering bins of an index; the default if there is no readable index."""
    try:
        return len(view_index(index).before)
    except DatasetError:
        return BINS


def split_sketch(index: Path, session: str) -> bytes:
    """A session's rows along time as an SVG: trained on, held out, or neither (grey)."""
    _, splits = _splits(index, session)
    height, total = 14, max(1, len(splits))
    parts = [f'<rect width="{_WIDTH}" height="{height}" fill="{_OTHER}"/>']
    for split, color in _COLORS.items():
        parts += [
            f'<rect x="{_WIDTH * first / total:.2f}" width="{_WIDTH * (last - first + 1) / total:.2f}"'
            f' height="{height}" fill="{color}"/>'
            for first, last in stretches(splits == split)
        ]
    return _svg(_WIDTH, height, parts)


def held_out_rows(index: Path, session: str) -> list[tuple[int, int]]:
    """The first and last rows of the stretches of a session that are held out for validation."""
    row, splits = _splits(index, session)
    return [(int(row[first]), int(row[last])) for first, last in stretches(splits == "validation")]


def _splits(index: Path, session: str) -> tuple[NDArray[np.int64], NDArray[np.str_]]:
    """The rows (N,) of a session in order, and their splits (N,)."""
    frames = read_frames(index / FRAMES_FOLDER / f"{session}.parquet", ["row", "split"]).sort_by("row")
    return frames["row"].to_numpy(), np.array([split or "" for split in frames["split"].to_pylist()], np.str_)


def _svg(width: int, height: int, parts: Sequence[str]) -> bytes:
    return svg(width, height, parts, ' preserveAspectRatio="none"')


def _text(value: Any) -> str:
    if isinstance(value, list):
        return printable(" ".join(map(str, value))) or "none"
    return printable("none" if value is None else str(value))
