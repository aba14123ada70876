"""Time and memory to open an index of many samples, and to draw the order of an epoch.

python benchmarks/many_samples.py [--samples 10000000]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dataset import load
from dataset.parquet_file import METADATA_KEY
from dataset.samples.samples_format import SAMPLES_FORMAT, SAMPLES_NAME
from recorder import Log, LogWriter

SESSIONS = 100
USES = 3  # of each picture: unchanged, mirrored, altered


def main() -> None:
    """Make an index in another process, open it, and print time and memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000_000)
    count = parser.parse_args().samples
    with tempfile.TemporaryDirectory() as name:
        few, many = Path(name) / "few", Path(name) / "many"
        spawned = multiprocessing.get_context("spawn")
        with spawned.Pool(1) as pool:
            pool.starmap(_make, [(few, 1_000), (many, count)])
        with spawned.Pool(1) as pool:  # another process, with its own peak memory
            print(pool.apply(_open, (many, few)))


def _open(index: Path, few: Path) -> str:
    load(few, budget_bytes=0).close()  # first, so that the memory of the libraries is not counted
    before = _peak_bytes()
    start = time.perf_counter()
    with load(index, budget_bytes=0) as loader:
        opened_s = time.perf_counter() - start
        opened = _peak_bytes() - before
        kept = sum(value.nbytes for value in vars(loader.rows).values() if isinstance(value, np.ndarray))
        start = time.perf_counter()
        order = loader.order(1)
        order_s = time.perf_counter() - start
        count = len(loader)
        return (
            f"{count:,} training samples, opened in {opened_s:.1f} s:"
            f" {kept / count:.0f} bytes a sample kept, {opened / count:.0f} at the peak;"
            f" order of an epoch in {order_s:.2f} s, {order.nbytes / count:.0f} bytes a sample"
        )


def _peak_bytes() -> int:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _make(index: Path, count: int) -> None:
    with LogWriter(index / "drive.mcap", {"source": "benchmark"}) as writer:
        writer.picture("center", 1, 0, b"\xff\xd8\xff no picture is read here")
    with Log(index / "drive.mcap") as log:
        source = {"log": "drive.mcap", "fingerprint": log.fingerprint}
    random = np.random.default_rng(0)
    picture, use = np.divmod(np.arange(count), USES)
    session = (picture * SESSIONS // (picture[-1] + 1)).astype(np.int32)
    names = ["", "blur", "brightness", "shadow", "blur+shadow"]
    columns = {
        "session": pa.DictionaryArray.from_arrays(session, [f"drive {i:03}" for i in range(SESSIONS)]),
        "row": picture // 3,
        "camera": pa.DictionaryArray.from_arrays((picture % 3).astype(np.int32), ["center", "left", "right"]),
        "log_time_ns": picture * 33_000_000,
        "offset": picture * 15_700,
        "length": 15_000 + picture % 1_000,
        "chunk": np.full(count, -1),
        "flip": use == 1,
        "alteration": pa.DictionaryArray.from_arrays(
            np.where(use == 2, random.integers(0, len(names), count), 0).astype(np.int32), names
        ),
        "seed": np.where(use == 2, random.integers(0, 2**32, count), 0),
        "label": random.uniform(-1, 1, count),
        "recorded": random.uniform(-1, 1, count),
        "bin": random.integers(0, 25, count),
        "split": np.where(picture // 500 % 5 == 0, "validation", "train"),
        "copy": use == 2,
    }
    logs = dict.fromkeys(columns["session"].dictionary.to_pylist(), source)
    metadata = {"format": SAMPLES_FORMAT, "settings": {}, "logs": logs}
    table = pa.table(columns).replace_schema_metadata({METADATA_KEY: json.dumps(metadata).encode()})
    pq.write_table(table, index / SAMPLES_NAME, compression="zstd")


if __name__ == "__main__":
    main()
