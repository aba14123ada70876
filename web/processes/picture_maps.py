"""Maps on which similar pictures of logs lie near each other, by the features of a run's network or by their
pixels. The cache keeps them by the fingerprints of the logs and of the run.

A process of this module makes them. It runs no user's own network code.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from common import UserError
from common.errors import printable
from dataset.loader.crops import LogCrops
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image
from recorder.log.road_places import states_of
from recorder.rows.causes import CAUSES
from recorder.rows.odd_stretches import odd_stretches
from web.errors import WebError
from web.processes.kept_work import KeptWork, counter, report, run_fingerprint, run_in_process, write_result
from web.processes.neighbour_map import ROUNDS, Floats, groups, neighbour_map

COLUMNS: Final = ("x", "y", "log", "row", "steering", "predicted", "nearest", "alone", "group", "odd")
"""Float32 columns of the pictures. `x`, `y`: its place. `log`: the number of its log. `predicted`: NaN without
one. `nearest`, `alone`: distances to the most similar picture and to its neighbours (medians: 1). `odd`: the
number of the kind of odd row, or -1."""
MAX_POINTS: Final = 10_000
_FORMAT: Final = 1
_BATCH: Final = 64
_PIXELS: Final = PictureSpec(width_px=64, height_px=32)
_SHRUNK: Final = (16, 8)  # pixels of a crop: small movements hardly change them
_GROUPS: Final = 24
_NICENESS: Final = 5


class MapAbout(msgspec.Struct, frozen=True):
    step: int  # every `step`-th picture is shown
    odd: list[str]  # the kinds of odd rows; the column `odd` has their numbers
    groups: list[int]  # the picture in the middle of each group
    max_deg: float | None  # the wheels' angle at steering 1; None: unknown, or logs have different angles
    notes: list[str]  # logs that were left out, and why


@dataclass(frozen=True)
class MappedLog:
    """A log whose pictures are shown."""

    at: str  # its address: /sessions/KEY
    path: Path
    fingerprint: str


class PictureMaps:
    """The maps that are kept, running and waiting."""

    def __init__(self, cache: Path) -> None:
        self.work = KeptWork(cache / "maps", "web.processes.picture_maps", "it was stopped")

    def key(self, logs: Sequence[MappedLog], run: Path | None) -> str:
        """The key of a map. Raises WebError for a run without weights."""
        network = run_fingerprint(run) if run else ""
        words = [str(_FORMAT), str(MAX_POINTS), network, *(log.fingerprint for log in logs)]
        return hashlib.sha256(" ".join(words).encode()).hexdigest()

    def find(self, key: str) -> MapAbout | None:
        """The description of the map of a key; None if it is not kept."""
        return self.work.find(key, lambda kept: msgspec.json.decode(kept["about"].tobytes(), type=MapAbout))

    def columns(self, key: str) -> bytes | None:
        """COLUMNS, one after the other; None if the map is not kept."""
        return self.work.find(key, lambda kept: b"".join(kept[name].astype("<f4").tobytes() for name in COLUMNS))

    def start(self, key: str, logs: Sequence[MappedLog], run: Path | None) -> None:
        """Start it, unless it is waiting or running."""
        pairs = [word for log in logs for word in (log.fingerprint, str(log.path.absolute()))]
        self.work.start(key, 0, [str(MAX_POINTS), str(run.absolute()) if run else "", *pairs])


def main() -> None:
    run_in_process(_work, _NICENESS)


def _work(max_points: str, run: str, *words: str) -> None:
    *pairs, result = words
    logs = list(zip(pairs[::2], pairs[1::2], strict=True))
    notes: list[str] = []
    parts: list[dict[str, NDArray[Any]]] = []  # of the columns
    angles = set()
    reader = _FeatureReader(Path(run) if run else None)
    total = sum(_pictures(log) for _, log in logs)
    step = max(1, -(-total // int(max_points)))
    shown = 0
    for number, (fingerprint, log) in enumerate(logs):
        with _skipped_if(notes, len(logs) > 1), LogCrops(Path(log)) as crops:
            for part in _parts(crops, fingerprint, step, reader):
                parts.append({**part, "log": np.full(len(part["row"]), number)})
                shown += len(part["row"])
                report(pictures=step * shown, total=total)
            angles.add(crops.max_steering_deg)
    if not parts:
        raise WebError("; ".join(notes) or "no picture of the centre camera in these logs")
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    laid_out = neighbour_map(columns.pop("features"), counter(stage="laid out", total=ROUNDS))
    place = laid_out.place
    group = groups(place, _GROUPS)
    max_deg = angles.pop() if len(angles) == 1 else None
    about = MapAbout(step, list(CAUSES), _middles(place, group), max_deg, notes)
    write_result(
        Path(result),
        x=place[:, 0],
        y=place[:, 1],
        nearest=laid_out.nearest,
        alone=laid_out.alone,
        group=group,
        about=np.frombuffer(msgspec.json.encode(about), np.uint8),
        **columns,
    )


@contextlib.contextmanager
def _skipped_if(notes: list[str], is_one_of_several: bool) -> Iterator[None]:
    """Skip an unreadable log if there are others."""
    try:
        yield
    except UserError as error:
        if not is_one_of_several:
            raise
        notes.append(printable(str(error)))


def _pictures(log: str) -> int:
    try:
        with LogCrops(Path(log)) as crops:
            return len(crops)
    except UserError:  # reported when its pictures are read
        return 0


class _FeatureReader:
    """Computes features of crops, by a run's network or from their pixels."""

    def __init__(self, run: Path | None) -> None:
        self.spec = _PIXELS
        self._network = None
        if run is not None:
            from model.runs.run_folder import load_network, picture_of_run  # loads PyTorch

            self.spec = picture_of_run(run)
            self._network = load_network(run).eval()

    def features(self, crops: Image) -> tuple[Floats, NDArray[np.float64]]:
        """Features (N, D) and predicted steering (N,) of crops (N, `spec.shape`); without a network, it is NaN.
        Raises WebError for a network with numbers that are not finite."""
        if self._network is None:
            shrunk = [cv2.resize(crop, _SHRUNK, interpolation=cv2.INTER_AREA) for crop in crops]
            pixels: Floats = np.array(shrunk, np.float32).reshape(len(crops), -1) / np.float32(255)
            return pixels, np.full(len(crops), np.nan)
        from dataset.prediction_targets import steering_in
        from model.evaluation.predict import as_input
        from model.network.visual_backprop import answers_and_features

        answers, features = answers_and_features(self._network, as_input(crops))
        if not (answers.isfinite().all() and features.isfinite().all()):
            raise WebError("this run's network computes numbers that are not finite: train it again")
        return features.numpy(), steering_in(answers.numpy().astype(np.float64))


def _parts(
    crops: LogCrops, fingerprint: str, step: int, reader: _FeatureReader
) -> Iterator[dict[str, NDArray[Any]]]:
    """The features and the columns of every `step`-th picture of a log, in batches."""
    odd, kinds = odd_stretches(states_of(crops.log)), list(CAUSES)
    if crops.log.fingerprint != fingerprint:
        name = crops.log.path.name
        raise WebError(f"{name}: the log has changed: reload this page, or bring the index up to date")
    for numbers, pictures in crops.batches(_BATCH, reader.spec, step):
        if not len(numbers):
            continue
        features, predicted = reader.features(pictures)
        row = crops.row[numbers]
        kind = np.full(len(row), -1)
        for stretch in reversed(odd):
            kind[(row >= stretch.first_row) & (row <= stretch.last_row)] = kinds.index(stretch.kind)
        yield {
            "features": features,
            "row": row,
            "steering": crops.recorded[numbers],
            "predicted": predicted,
            "odd": kind,
        }


def _middles(place: Floats, group: NDArray[np.int32]) -> list[int]:
    """For each group, the picture nearest to its middle."""
    middles = []
    for number in range(int(group.max()) + 1):
        members = np.flatnonzero(group == number)
        apart = ((place[members] - place[members].mean(0)) ** 2).sum(1)
        middles.append(int(members[apart.argmin()]))
    return middles
