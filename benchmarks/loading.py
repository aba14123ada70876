"""How fast pictures are loaded in random order, compared with OpenCV alone and PyTorch's DataLoader.

bc-index --no-balance --no-flip --gap-s 0 --index plain    # every picture once
python benchmarks/loading.py plain

All contenders give the same crops of the same pictures (this is checked), in batches, from a warm page cache.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from torch.utils.data import DataLoader

from dataset import Loader, Samples, decode, preprocess

ROUNDS, BATCH = 5, 256

Epoch = Callable[[], Iterable[Any]]  # batches of crops


def main() -> None:
    """Print pictures/s (median, minimum to maximum of several rounds) and their share of OpenCV's in each
    round."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("index", type=Path)
    samples = Samples(parser.parse_args().index)
    table = _each_picture_once(samples.table)
    places = [
        (samples.logs[row["session"]], row["offset"], row["length"], row["chunk"]) for row in table.to_pylist()
    ]
    jpegs = [log.read(*place) for log, *place in places]
    print(f"{len(jpegs):,} pictures of {statistics.fmean(map(len, jpegs)) / 1000:.1f} KB; {ROUNDS} rounds")
    print(f"one random JPEG by byte range: {_spread([_random_read_us(places) for _ in range(ROUNDS)], 1)} us")
    with tempfile.TemporaryDirectory() as name:
        limits: dict[str, tuple[int, Epoch]] = {
            "OpenCV alone, bytes in memory, 1 thread": (1, lambda: _opencv(jpegs, 1)),
            "OpenCV alone, bytes in memory, 2 threads": (2, lambda: _opencv(jpegs, 2)),
        }
        contenders: dict[str, tuple[int, Epoch]] = {
            **_ours(samples, table),
            **_single_files(Path(name), jpegs),
        }
        expected = sorted(zlib.crc32(preprocess(decode(jpeg)).tobytes()) for jpeg in jpegs)
        counts = {what: _check(what, epoch, expected) for what, (_, epoch) in contenders.items()}
        counts.update(dict.fromkeys(limits, len(jpegs)))
        contenders = limits | contenders
        rates: dict[str, list[float]] = {what: [] for what in contenders}
        for _ in range(ROUNDS):
            for what, (_, epoch) in contenders.items():
                start = time.perf_counter()
                for _batch in epoch():
                    pass
                rates[what].append(counts[what] / (time.perf_counter() - start))
    opencv = dict(zip((1, 2), list(rates.values())[:2], strict=True))
    for what, (threads, _) in contenders.items():
        shares = [rate / limit for rate, limit in zip(rates[what], opencv[threads], strict=True)]
        print(f"{what:45} {_spread(rates[what]):>28} pictures/s  {statistics.median(shares):5.2f}")
    samples.close()


def _opencv(jpegs: list[bytes], threads: int) -> list[None]:
    """The limit: it reads nothing, and drops the crops."""

    def work(part: Any) -> None:
        for i in part.tolist():
            preprocess(decode(jpegs[i]))

    order = np.random.default_rng(0).permutation(len(jpegs))
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, np.array_split(order, -(-len(jpegs) // 64))))


def _ours(samples: Samples, table: pa.Table) -> dict[str, tuple[int, Epoch]]:
    def first(threads: int) -> Iterator[Any]:
        # This includes opening the logs, which are few, and checking the CRCs of their chunks.
        with Loader(Samples(samples.path.parent), table, batch=BATCH, budget_bytes=0, threads=threads) as fresh:
            yield from (batch.pictures for batch in fresh.epoch(0))

    def later(loader: Loader) -> Iterator[Any]:
        return (batch.pictures for batch in loader.epoch(0))

    loaders: dict[str, tuple[int, Epoch]] = {}
    for n, threads in ((1, "1 thread"), (2, "2 threads")):
        for what, budget in (("nothing kept", 0), ("crops in memory", 1 << 40)):
            loader = Loader(samples, table, batch=BATCH, budget_bytes=budget, threads=n)
            loaders[f"this loader, {what}, {threads}"] = (n, lambda loader=loader: later(loader))  # type: ignore[misc]
        loaders[f"this loader, first pass, {threads}"] = (n, lambda n=n: first(n))  # type: ignore[misc]
    return loaders


class _Files:
    """A plain PyTorch data set of single files."""

    def __init__(self, paths: list[Path]) -> None:
        self.paths = paths

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, at: int) -> Any:
        return preprocess(decode(self.paths[at].read_bytes()))


def _single_files(folder: Path, jpegs: list[bytes]) -> dict[str, tuple[int, Epoch]]:
    """PyTorch's DataLoader, without and with two workers, which start once, before the rounds."""
    paths = [folder / f"{number:06}.jpg" for number in range(len(jpegs))]
    for path, jpeg in zip(paths, jpegs, strict=True):
        path.write_bytes(jpeg)
    loaders: dict[str, tuple[int, Epoch]] = {}
    for workers in (0, 2):
        files: Any = _Files(paths)
        loader: DataLoader[Any] = DataLoader(
            files, BATCH, shuffle=True, num_workers=workers, persistent_workers=workers > 0
        )
        what = f"single JPEG files, PyTorch's DataLoader, {workers} workers"
        loaders[what] = (max(1, workers), lambda loader=loader: loader)  # type: ignore[misc]
    return loaders


def _check(what: str, epoch: Epoch, expected: list[int]) -> int:
    """Check that an epoch gives every crop once. Returns their number."""
    crcs = sorted(zlib.crc32(np.asarray(crop).tobytes()) for batch in epoch() for crop in batch)
    if crcs != expected:
        raise SystemExit(f"{what}: {len(crcs)} crops; expected {len(expected)} other ones")
    return len(crcs)


def _random_read_us(places: list[Any]) -> float:
    order = np.random.default_rng(0).permutation(len(places)).tolist()
    start = time.perf_counter()
    for at in order:
        log, *place = places[at]
        log.read(*place)
    return 1e6 * (time.perf_counter() - start) / len(places)


def _each_picture_once(table: pa.Table) -> pa.Table:
    """The samples of all splits that are neither mirrored nor copies."""
    return table.filter(pc.invert(pc.or_(table["flip"], table["copy"])))


def _spread(values: list[float], digits: int = 0) -> str:
    return f"{statistics.median(values):,.{digits}f} ({min(values):,.{digits}f} to {max(values):,.{digits}f})"


if __name__ == "__main__":
    main()
