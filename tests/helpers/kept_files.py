"""Writes small files of this version into tests/data/VERSION, to be kept: later versions must read them.

    python tests/helpers/kept_files.py

Once for each release, before it is tagged (CONTRIBUTING.md).
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from common.versions import VERSION
from dataset import IndexConfig, Samples, build_index, decode
from logs import write_log
from model import load_pilot, train
from recorder import Log
from repository import ROOT
from toy import SMALL, STEERING, road, toy_index

DATA = ROOT / "tests" / "data"
ROWS = range(0, 40, 4)  # of which pictures and answers are kept


def main() -> None:
    folder = DATA / VERSION
    if folder.exists():
        sys.exit(f"{folder}: exists already: what a version has written stays as it is")
    index = toy_index(folder)
    keep_divided(folder)
    train(index, folder / "run", SMALL)
    shutil.rmtree(folder / "run" / "last")  # four times as large as the weights
    remove_of_this_machine(index)
    write(folder / "expected.json", expected(folder, index))


def keep_divided(folder: Path) -> None:
    """An index whose samples are a file a session, of the log in the folder and another one."""
    more = write_log(folder / "more.mcap", STEERING[:12], road, cameras=["center"], start_ns=10**18)
    config = IndexConfig(max_uses=2, block_s=0.5, gap_s=0)
    index = build_index([folder / "toy.mcap", more], folder / "divided", config, divide_from_frames=1).path
    remove_of_this_machine(index)
    with Samples(index) as samples:
        told = {"labels": labels(samples), "fingerprint": samples.fingerprint}
    write(folder / "expected_divided.json", told)


def remove_of_this_machine(index: Path) -> None:
    for name in ("state.json", ".lock"):
        (index / name).unlink()


def write(path: Path, told: Mapping[str, object]) -> None:
    path.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


def labels(samples: Samples) -> list[float]:
    found: list[float] = np.round(samples.table["label"].to_numpy(), 6).tolist()
    return found


def expected(folder: Path, index: Path) -> dict[str, object]:
    """What is in these files, by the version that has written them."""
    pilot = load_pilot(folder / "run", "float32")
    with Log(folder / "toy.mcap") as log, Samples(index) as samples:
        pictures = [log.picture(row) for row in ROWS]
        answers = [pilot.predict(pilot.crop(decode(picture))) for picture in pictures]
        return {
            "steering": log.vehicle()["steering"].to_pylist(),
            "pictures": [hashlib.sha256(picture).hexdigest() for picture in pictures],
            "predicted": np.round(answers, 6).tolist(),
            "labels": labels(samples),
            "fingerprint": samples.fingerprint,
        }


if __name__ == "__main__":
    main()
