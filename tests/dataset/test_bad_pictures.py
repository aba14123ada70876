"""Pictures that do not decode are left out of the batches, named and counted; the others come as ever."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from torch import Tensor

from common.car import Camera
from dataset import Batch, DatasetError, IndexConfig, SamplesDataset, build_index, load
from model.evaluation.predict import predict
from model.network.original import SteeringNetwork
from model.training.batches import DeviceBatches
from tests.helpers.layouts import write_as_before
from tests.helpers.logs import write_log
from tests.helpers.plain_mcap import contents
from tests.helpers.udacity import encode

STEERING = [round(-0.6 + 0.05 * row, 2) for row in range(24)]
BROKEN: dict[tuple[Camera, int], bytes] = {
    ("left", 2): b"this is no picture",
    ("center", 5): b"",
    ("center", 11): b"\xff\xd8\xff\xe0 cut off",
}
NAMES = {f"lake row {row} {camera}" for camera, row in BROKEN}


def shade(camera: Camera, row: int) -> int:
    """Which grey the picture of a camera and row has: far enough apart to survive JPEG."""
    return 20 + 3 * (3 * row + ["left", "center", "right"].index(camera))


def picture(camera: Camera, row: int) -> bytes:
    if (camera, row) in BROKEN:
        return BROKEN[camera, row]
    return encode(np.full((160, 320, 3), shade(camera, row), np.uint8))


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    log = write_log(folder / "lake.mcap", STEERING, picture)
    config = IndexConfig(validation_share=0.0, balance=False)
    return build_index([log], folder / "index", config).path


def expected(index: Path) -> list[tuple[int, float]]:
    """Shade and label of every sample whose picture is whole, in the order of the index."""
    rows = pq.read_table(index / "samples.parquet").to_pylist()
    assert {(row["camera"], row["row"]) for row in rows} > BROKEN.keys()
    return [
        (shade(row["camera"], row["row"]), float(np.float32(row["label"])))
        for row in rows
        if (row["camera"], row["row"]) not in BROKEN
    ]


def seen(pictures: np.ndarray | Tensor, steering: np.ndarray | Tensor) -> list[tuple[int, float]]:
    levels = np.asarray(pictures).reshape(len(pictures), -1).mean(axis=1).round().astype(int).tolist()
    return list(zip(levels, np.asarray(steering).tolist(), strict=True))


def seen_in(batches: Sequence[Batch]) -> list[tuple[int, float]]:
    return [sample for batch in batches for sample in seen(batch.pictures, batch.steering)]


@pytest.mark.parametrize("budget_bytes", [0, 1 << 30])
def test_an_undecodable_picture_leaves_its_batches_and_is_named_once(index: Path, budget_bytes: int) -> None:
    with load(index, batch=16, budget_bytes=budget_bytes) as loader:
        assert len(loader.skipped) == 0
        for epoch in (1, 2):
            batches = list(loader.epoch(epoch))
            assert len(batches) == loader.batches
            assert min(len(batch.steering) for batch in batches[:-1]) < 16
            assert sorted(seen_in(batches)) == sorted(expected(index))
        assert sum(len(batch.steering) for batch in batches) < len(loader)
        assert [reason for reason, _ in loader.skipped] == ["pictures that do not decode"] * len(BROKEN)
        assert {name for _, name in loader.skipped} == NAMES


def test_predictions_stay_beside_what_was_recorded(index: Path) -> None:
    with load(index, batch=16) as loader:
        assert seen_in(list(loader.in_order())) == expected(index)
        assert len(loader.skipped) == len(BROKEN)
    with load(index, batch=16, driving_view=True) as loader:
        predicted, recorded = predict(SteeringNetwork(), loader)
        assert {name for _, name in loader.skipped} == {"lake row 5 center", "lake row 11 center"}
    assert len(predicted) == len(recorded) == len(STEERING) - 2
    assert recorded.tolist() == [np.float32(value) for row, value in enumerate(STEERING) if row not in (5, 11)]


def test_crops_on_the_device_are_without_them_too(index: Path) -> None:
    with load(index, batch=16) as host, load(index, batch=16) as other:
        device = DeviceBatches(other, torch.device("cpu"))
        assert {name for _, name in other.skipped} == NAMES  # all are read before the first epoch
        for epoch in (1, 2):
            for batch, (pictures, steering) in zip(host.epoch(epoch), device.epoch(epoch), strict=True):
                assert seen(pictures, steering) == seen_in([batch])
        assert len(other.skipped) == len(BROKEN)


@pytest.mark.parametrize("layout", ["two kinds of chunks", "of an earlier version"])
def test_pictures_of_a_damaged_chunk_are_left_out_and_named_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str
) -> None:
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 20_000)
    log = write_log(tmp_path / "lake.mcap", STEERING, picture)
    if layout == "of an earlier version":
        write_as_before(log, tmp_path / "before.mcap", 20_000).replace(log)
    build_index([log], tmp_path / "index", IndexConfig(validation_share=0.0, balance=False))
    place = log.read_bytes().index(b"this is no picture")
    chunk = next(chunk for chunk in contents(log).chunks if chunk.start < place < chunk.end)
    lost = {
        (message.topic.rpartition("/")[2], message.sequence)
        for message in chunk.messages
        if "camera" in message.topic
    }
    assert 3 < len(lost) < 30
    with log.open("rb+") as stream:
        stream.seek(place)
        stream.write(b"THIS")
    rows = pq.read_table(tmp_path / "index" / "samples.parquet").to_pylist()
    expected = [
        (shade(row["camera"], row["row"]), float(np.float32(row["label"])))
        for row in rows
        if (row["camera"], row["row"]) not in BROKEN and (row["camera"], row["row"]) not in lost
    ]
    with load(tmp_path / "index", batch=16) as loader:
        for epoch in (1, 2):
            assert sorted(seen_in(list(loader.epoch(epoch)))) == sorted(expected)
        in_damage = [name for kind, name in loader.skipped if kind.startswith("pictures in damaged chunks of ")]
        assert len(in_damage) == len(lost)
        if layout == "two kinds of chunks":  # the rows of the other layout are among what is damaged
            assert set(in_damage) == {f"lake row {row} {camera}" for camera, row in lost}
    at = next(number for number, row in enumerate(rows) if (row["camera"], row["row"]) == ("left", 2))
    dataset = SamplesDataset(tmp_path / "index")
    with pytest.raises(DatasetError, match=r"lake\.mcap: damaged.*`bc-log recover"):
        dataset[at]
    dataset.close()
