"""Writes small files of this version into tests/data/VERSION, to be kept: later versions must read them.

    python -m tests.helpers.kept_files

Once for each release, before it is tagged (CONTRIBUTING.md).
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from pathlib import Path

import numpy as np

from common.versions import VERSION
from dataset import Samples, decode
from model import load_pilot, train
from recorder import Log
from tests.helpers.repository import ROOT
from tests.helpers.toy import SMALL, toy_index

DATA = ROOT / "tests" / "data"
ROWS = range(0, 40, 4)  # of which pictures and answers are kept


def main() -> None:
    folder = DATA / VERSION
    if folder.exists():
        sys.exit(f"{folder}: exists already: what a version has written stays as it is")
    index = toy_index(folder)
    train(index, folder / "run", SMALL)
    shutil.rmtree(folder / "run" / "last")  # four times as large as the weights
    for name in ("state.json", ".lock"):  # of this machine
        (index / name).unlink()
    reported = json.dumps(expected(folder, index), indent=1)
    (folder / "expected.json").write_text(reported + "\n", encoding="utf-8")


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
            "labels": np.round(samples.table["label"].to_numpy(), 6).tolist(),
            "fingerprint": samples.fingerprint,
        }


if __name__ == "__main__":
    main()
