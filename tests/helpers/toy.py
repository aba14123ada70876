"""A road that is learnt in seconds: a white post on black, the farther to the right the more the steering."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from common.car import Camera
from dataset import IndexConfig, build_index
from model import TrainConfig
from tests.helpers.logs import write_log
from tests.helpers.udacity import encode

TINY = replace(
    TrainConfig.of("original"),
    epochs=4,
    batch=4,
    rate=2e-4,
    dropout=0.0,
    seed=1,
    precision="float32",
    threads=1,
)
SMALL = replace(TINY, network="small")
"""A tenth of the time, most of which the original's 5 million weights take, which are saved and read again: for
all that is the same whatever the network."""
ONE = replace(SMALL, epochs=1, batch=8)
"""An epoch of it."""
STEERING = [round(0.8 * math.sin(row / 3), 3) for row in range(40)]


def road(camera: Camera, row: int) -> bytes:
    picture = np.zeros((160, 320, 3), np.uint8)
    middle = round(160 + 140 * STEERING[row])
    picture[:, middle - 20 : middle + 20] = 255
    return encode(picture)


def toy_index(folder: Path) -> Path:
    """The index of a session of 40 rows at `folder`/toy.mcap, a part of them held out."""
    log = write_log(folder / "toy.mcap", STEERING, road, cameras=["center"])
    return build_index([log], folder / "index", IndexConfig(flip=False, max_uses=1, block_s=0.5, gap_s=0)).path
