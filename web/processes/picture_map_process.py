"""The process that makes a map of pictures: similar ones lie near each other, by the features of a run's network
or by their pixels. It reports progress on stdout, and writes a file. It runs no user's own network code."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from common import UserError
from common.errors import printable
from common.location import location
from dataset.loader.log_crops import LogCrops
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image
from recorder import Log
from recorder.log_copy_cli import brought_here
from recorder.rows.odd_stretches import ODD_KINDS, odd_stretches
from recorder.rows.row_quality import States
from web.errors import WebError
from web.processes.kept_work import write_result
from web.processes.neighbour_map import ROUNDS, Floats, groups, neighbour_map
from web.processes.own_process import report, run_in_process
from web.processes.picture_maps import MapAbout

_BATCH: Final = 64
_PIXELS: Final = PictureSpec(width_px=64, height_px=32)
_SHRUNK: Final = (16, 8)  # pixels of a crop: small movements hardly change them
_GROUPS: Final = 24
_NICENESS: Final = 5


@dataclass
class _Columns:
    """The columns of a map, in parts."""

    features: list[Floats] = field(default_factory=list)
    log: list[NDArray[np.int64]] = field(default_factory=list)
    row: list[NDArray[np.int64]] = field(default_factory=list)
    steering: list[NDArray[np.float64]] = field(default_factory=list)
    predicted: list[NDArray[np.float64]] = field(default_factory=list)
    odd: list[NDArray[np.int64]] = field(default_factory=list)


def main() -> None:
    run_in_process(_work, _NICENESS)


def _work(max_points: str, run: str, *words: str) -> None:
    *pairs, result = words
    logs = list(zip(pairs[::2], pairs[1::2], strict=True))
    _make(logs, Path(run) if run else None, int(max_points), Path(result))


def _make(logs: Sequence[tuple[str, str]], run: Path | None, max_points: int, result: Path) -> None:
    notes: list[str] = []
    columns = _Columns()
    reader = _FeatureReader(run)
    total = sum(_pictures(log) for _, log in logs)
    step = max(1, -(-total // max_points))
    angles = set()
    for number, (fingerprint, log) in enumerate(logs):
        with _skipped_if(notes, len(logs) > 1), brought_here([location(log)]) as (path,):
            angles.add(_look(path, number, fingerprint, step, reader, columns, total))
    if not columns.row:
        raise WebError("; ".join(notes) or "no picture of the centre camera in these logs")
    features = np.concatenate(columns.features)
    rounds = 0

    def on_round() -> None:
        nonlocal rounds
        rounds += 1
        report(stage="laid out", pictures=rounds, total=ROUNDS)

    laid_out = neighbour_map(features, on_round)
    place = laid_out.place
    group = groups(place, _GROUPS)
    max_deg = angles.pop() if len(angles) == 1 else None
    about = MapAbout(step, list(ODD_KINDS), _middles(place, group), max_deg, notes)
    write_result(
        result,
        x=place[:, 0],
        y=place[:, 1],
        nearest=laid_out.nearest,
        alone=laid_out.alone,
        group=group,
        about=np.frombuffer(msgspec.json.encode(about), np.uint8),
        **{
            name: np.concatenate(getattr(columns, name)) for name in ("log", "row", "steering", "predicted", "odd")
        },
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
        with brought_here([location(log)]) as (path,), LogCrops(path) as crops:
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
        from model.network.inner_features import answers_and_features

        answers, features = answers_and_features(self._network, as_input(crops))
        if not (answers.isfinite().all() and features.isfinite().all()):
            raise WebError("this run's network computes numbers that are not finite: train it again")
        return features.numpy(), steering_in(answers.numpy().astype(np.float64))


def _look(
    path: Path, number: int, fingerprint: str, step: int, reader: _FeatureReader, columns: _Columns, total: int
) -> float | None:
    """Add the pictures of a log to the columns. Return the angle of its car's wheels at steering 1."""
    with Log(path) as log:
        odd = odd_stretches(States.of(log.vehicle()))
    kinds = list(ODD_KINDS)
    with LogCrops(path) as crops:
        if crops.log.fingerprint != fingerprint:
            raise WebError(f"{path.name}: the log has changed: reload this page, or bring the index up to date")
        for numbers, pictures in crops.batches(_BATCH, reader.spec, step):
            if not len(numbers):
                continue
            features, predicted = reader.features(pictures)
            rows = crops.row[numbers]
            kind = np.full(len(rows), -1)
            for stretch in reversed(odd):
                kind[(rows >= stretch.first_row) & (rows <= stretch.last_row)] = kinds.index(stretch.kind)
            columns.features.append(features)
            columns.log.append(np.full(len(rows), number))
            columns.row.append(rows)
            columns.steering.append(crops.recorded[numbers])
            columns.predicted.append(predicted)
            columns.odd.append(kind)
            report(pictures=step * sum(map(len, columns.row)), total=total)
        return crops.max_steering_deg


def _middles(place: Floats, group: NDArray[np.int32]) -> list[int]:
    """For each group, the picture nearest to its middle."""
    middles = []
    for number in range(int(group.max()) + 1):
        members = np.flatnonzero(group == number)
        apart = ((place[members] - place[members].mean(0)) ** 2).sum(1)
        middles.append(int(members[apart.argmin()]))
    return middles
