"""Maps on which similar pictures of logs lie near each other, by the features of a run's network or by their
pixels. The cache keeps them by the fingerprints of the logs and of the run.

A process of this module makes them, after UMAP (McInnes, Healy, Melville 2018, arXiv 1802.03426), in NumPy: a
graph of nearest neighbours, whose edges attract, and random others, which repel. It runs no user's own network
code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

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

Floats = NDArray[np.float32]

NEIGHBOURS: Final = 15
_DIMENSIONS: Final = 30  # in which neighbours are searched
_A, _B = 1.577, 0.895  # how near neighbours lie, as UMAP's min_dist of 0.1
ROUNDS: Final = 300
_REPELLED: Final = 10  # random others, in each round
_STEP: Final = 0.25  # the first round's; attraction of all neighbours at once overshoots with UMAP's 1.0
_MAX_MOVE: Final = 4.0
_BLOCK: Final = 1024  # rows of distances at once


class NeighbourMap(NamedTuple):
    place: Floats  # (N, 2)
    nearest: Floats  # (N,) the distance to the most similar thing; its median is 1
    alone: Floats  # (N,) the mean distance to the neighbours; its median is 1


def neighbour_map(features: Floats, on_round: Callable[[], object] = lambda: None) -> NeighbourMap:
    """The map of features (N, D). The same features give the same map on the same machine. `on_round` is called
    ROUNDS times."""
    count = len(features)
    reduced = principal(features, _DIMENSIONS)
    if count <= NEIGHBOURS + 1:
        return NeighbourMap(_two(reduced), np.ones(count, np.float32), np.ones(count, np.float32))
    neighbour, distance = _nearest(reduced)
    place = _laid_out(_two(reduced), neighbour, _weights(distance), on_round)
    return NeighbourMap(place, _usual(distance[:, 0]), _usual(distance.mean(1)))


def principal(features: Floats, dimensions: int) -> Floats:
    """The features (N, D) along their first principal axes: (N, at most `dimensions`)."""
    centred = features - features.mean(0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    axes = axes[:, ::-1][:, :dimensions]
    axes = axes * np.where(np.take_along_axis(axes, abs(axes).argmax(0)[None], 0) < 0, -1, 1)  # one of two signs
    reduced: Floats = (centred @ axes).astype(np.float32)
    return reduced


def groups(place: Floats, max_groups: int) -> NDArray[np.int32]:
    """The group of each place (N, 2) by k-means, which starts with places far from each other. 0 is the largest
    group."""
    centres = [place.mean(0)]
    gap = ((place - centres[0]) ** 2).sum(1)
    for _ in range(min(max_groups, len(place)) - 1):
        centres.append(place[gap.argmax()])
        gap = np.minimum(gap, ((place - centres[-1]) ** 2).sum(1))
    middle = np.array(centres)
    group = np.zeros(len(place), np.int64)
    for _ in range(30):
        group = ((place[:, None] - middle[None]) ** 2).sum(2).argmin(1)
        size = np.bincount(group, minlength=len(middle))
        for axis in (0, 1):
            total = np.bincount(group, place[:, axis], len(middle))
            middle[:, axis] = np.where(size, total / np.maximum(size, 1), middle[:, axis])
    order = np.argsort(-np.bincount(group, minlength=len(middle)), kind="stable")
    return np.argsort(order)[group].astype(np.int32)


def _two(reduced: Floats) -> Floats:
    """The first two axes, as wide as UMAP's start; zeros if all things are equal."""
    place = np.zeros((len(reduced), 2), np.float32)
    place[:, : min(2, reduced.shape[1])] = reduced[:, :2]
    return (place * (10 / (abs(place).max() or 1))).astype(np.float32)


def _usual(distance: Floats) -> Floats:
    return (distance / (np.median(distance) or 1)).astype(np.float32)


def _nearest(points: Floats) -> tuple[NDArray[np.int64], Floats]:
    """The nearest others of each of N points, and their ascending distances: both (N, NEIGHBOURS)."""
    squares = (points**2).sum(1)
    neighbours, distances = [], []
    for start in range(0, len(points), _BLOCK):
        block = points[start : start + _BLOCK]
        apart = squares - 2 * block @ points.T
        apart[np.arange(len(block)), np.arange(start, start + len(block))] = np.inf
        unsorted = np.argpartition(apart, NEIGHBOURS, 1)[:, :NEIGHBOURS]
        exact = np.linalg.norm(points[unsorted] - block[:, None], axis=2)  # the difference of squares loses digits
        order = exact.argsort(1, kind="stable")
        neighbours.append(np.take_along_axis(unsorted, order, 1))
        distances.append(np.take_along_axis(exact, order, 1))
    return np.concatenate(neighbours), np.concatenate(distances)


def _weights(distance: Floats) -> Floats:
    """The weight of each neighbour (N, NEIGHBOURS): 1 for the nearest; their sum is log2 of their number."""
    beyond = distance - distance[:, :1]
    low, high = np.zeros(len(distance)), np.full(len(distance), np.inf)
    width = np.ones(len(distance))
    for _ in range(40):
        too_much = np.exp(-beyond / width[:, None]).sum(1) > np.log2(NEIGHBOURS)
        high, low = np.where(too_much, width, high), np.where(too_much, low, width)
        width = np.where(np.isinf(high), width * 2, (low + high) / 2)
        width = np.clip(width, 1e-6, 1e6)
    return np.exp(-beyond / width[:, None]).astype(np.float32)


def _laid_out(
    place: Floats, neighbour: NDArray[np.int64], weight: Floats, on_round: Callable[[], object]
) -> Floats:
    count = len(place)
    random = np.random.default_rng(0)
    place = place + random.normal(0, 1e-3, place.shape).astype(np.float32)  # equal ones would never separate
    tail, head = np.repeat(np.arange(count), NEIGHBOURS), neighbour.ravel()
    pull = weight.ravel()
    pushed = (pull.reshape(count, -1).sum(1) / _REPELLED)[:, None, None] * 5  # UMAP's five others for each pull
    for number in range(ROUNDS):
        on_round()
        step = np.float32(_STEP * (1 - number / ROUNDS))
        apart = place[tail] - place[head]
        square = np.maximum((apart**2).sum(1), 1e-12)
        pulled = apart * (pull * -2 * _A * _B * square ** (_B - 1) / (1 + _A * square**_B))[:, None]
        others = place[:, None] - place[random.integers(0, count, (count, _REPELLED))]
        square = (others**2).sum(2, keepdims=True)
        moves = others * (2 * _B / ((0.001 + square) * (1 + _A * square**_B)))
        move = (np.clip(moves, -_MAX_MOVE, _MAX_MOVE) * pushed).sum(1)
        for axis in (0, 1):
            move[:, axis] += np.bincount(tail, pulled[:, axis], count) - np.bincount(head, pulled[:, axis], count)
        place = place + step * np.clip(move, -_MAX_MOVE, _MAX_MOVE)
    return place.astype(np.float32)


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
    at: str  # its address: /sessions/KEY
    path: Path
    fingerprint: str


class PictureMaps:
    def __init__(self, cache: Path) -> None:
        self.work = KeptWork(cache / "maps", "web.processes.picture_maps", "it was stopped")

    def key(self, logs: Sequence[MappedLog], run: Path | None) -> str:
        """The key of a map. Raises WebError for a run without weights."""
        network = run_fingerprint(run) if run else ""
        words = [str(_FORMAT), str(MAX_POINTS), network, *(log.fingerprint for log in logs)]
        return hashlib.sha256(" ".join(words).encode()).hexdigest()

    def find(self, key: str) -> MapAbout | None:
        return self.work.find(key, lambda kept: msgspec.json.decode(kept["about"].tobytes(), type=MapAbout))

    def columns(self, key: str) -> bytes | None:
        """COLUMNS, one after the other; None if the map is not kept."""
        return self.work.find(key, lambda kept: b"".join(kept[name].astype("<f4").tobytes() for name in COLUMNS))

    def start(self, key: str, logs: Sequence[MappedLog], run: Path | None) -> None:
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
        try:
            with LogCrops(Path(log)) as crops:
                for part in _parts(crops, fingerprint, step, reader):
                    parts.append({**part, "log": np.full(len(part["row"]), number)})
                    shown += len(part["row"])
                    report(pictures=step * shown, total=total)
                angles.add(crops.max_steering_deg)
        except UserError as error:
            notes.append(printable(str(error)))
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
