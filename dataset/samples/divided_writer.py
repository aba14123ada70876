"""Samples of so many frames that one process should not hold them: a file a session, each made by a task.

    index/samples.parquet                   no rows; what they were made from, and how they were balanced
    index/samples/DIGEST/SESSION.parquet    the samples of a session

Balancing needs of each session only how many candidates every bin has. From these follows what is used of each
(`dataset.samples.balance.shares`), and each is drawn by itself: with a generator of its own, because one for all
would have to know all of them. So the balance is that of one file, bin by bin; which frames are drawn is not.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.progress import track
from common.tasks import Tasks, one_by_one
from dataset.config import IndexConfig
from dataset.frames.frames_file import read_frames
from dataset.parquet_file import write_table
from dataset.samples.balance import Quota, quota_of, shares
from dataset.samples.filter import Condition
from dataset.samples.sample_choice import choose_share, count_candidates
from dataset.samples.samples_format import (
    DIVIDED_FORMAT,
    SAMPLES_SCHEMA,
    Balance,
    Division,
    SessionCounts,
    SessionLabels,
)
from dataset.samples.samples_writer import (
    FROM_FRAMES,
    UsableFrames,
    nothing_usable,
    samples_metadata,
    samples_table,
    slower_set_speeds_mph,
    usable_frames,
)


@dataclass(frozen=True)
class _Session:
    """The description of a session for the task that writes its samples."""

    name: str
    frames: Path
    labels: SessionLabels
    slower_mph: list[float]
    config: IndexConfig

    def random(self) -> np.random.Generator:
        """A generator for this session, which does not depend on the other sessions."""
        number = int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:8], "big")
        return np.random.default_rng((self.config.seed, 2, number))

    def usable(self) -> tuple[UsableFrames, SessionCounts]:
        condition = Condition(self.config.where) if self.config.where is not None else None
        return usable_frames(read_frames(self.frames), self.config, self.labels, self.slower_mph, condition)


def write_divided_samples(
    frames: Mapping[str, Path],
    path: Path,
    config: IndexConfig,
    logs: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, SessionLabels],
    tasks: Tasks = one_by_one,
) -> tuple[Balance, dict[str, SessionCounts]]:
    """As `write_samples`, into files beside `path`, a session each: this process holds 25 numbers of a session."""
    slower_mph = slower_set_speeds_mph(labels)
    sessions = [_Session(name, file, labels[name], slower_mph[name], config) for name, file in frames.items()]
    counting = tasks(_count, [(session,) for session in sessions])
    counted = dict(track(counting, "counting what can be used", len(sessions)))
    candidates = np.stack([counted[number][0] for number in range(len(sessions))])
    usable = [counted[number][1] for number in range(len(sessions))]
    counts = {session.name: counted[number][2] for number, session in enumerate(sessions)}
    made_from = [counted[number][3] for number in range(len(sessions))]
    if not any(usable):
        raise nothing_usable(config, counts)
    balance, of_sessions = _divide(candidates, config)
    metadata = samples_metadata(config, logs, labels, balance, counts)
    digest = hashlib.sha256(json.dumps([metadata, made_from], sort_keys=True).encode()).hexdigest()
    with_samples = [number for number in range(len(sessions)) if usable[number]]
    parts = Division(digest, tuple(sessions[number].name for number in with_samples))
    folder = Path(str(parts.folder(path.parent)))
    folder.mkdir(parents=True)
    calls = [(sessions[number], of_sessions[number], folder, digest) for number in with_samples]
    for _ in track(tasks(_write, calls), "writing samples", len(calls)):
        pass
    write_table(path, SAMPLES_SCHEMA.empty_table(), {"format": DIVIDED_FORMAT, **metadata, "parts": asdict(parts)})
    return balance, counts


def _divide(candidates: NDArray[np.int64], config: IndexConfig) -> tuple[Balance, list[Quota]]:
    """The balance of all candidates (sessions, bins), and the quota of each session."""
    before = candidates.sum(axis=0)
    quota, per_bin, short = Quota(before, np.zeros_like(before)), 0, dict[int, int]()
    if config.balance:
        quota, per_bin, short = quota_of(before, config.max_uses, config.per_bin)
    return Balance(before, quota.originals + quota.copies, per_bin, short), shares(quota, candidates)


def _count(session: _Session) -> tuple[NDArray[np.int64], int, SessionCounts, str]:
    """The number of a session's candidates for training in each bin, that of its usable frames, its counts, and
    the SHA-256 of its frames file."""
    usable, counts = session.usable()
    with session.frames.open("rb") as stream:
        made_from = hashlib.file_digest(stream, "sha256").hexdigest()
    candidates = count_candidates(usable.label, usable.is_training, session.config)
    return candidates, len(usable.label), counts, made_from


def _write(session: _Session, share: Quota, folder: Path, digest: str) -> None:
    """Write the samples of a session; the same ones each time."""
    usable, _ = session.usable()
    chosen = choose_share(usable.label, usable.is_training, session.config, share, session.random())
    frames = read_frames(session.frames, FROM_FRAMES).take(pa.array(usable.position[chosen.frame]))
    table = samples_table(frames, usable.taken(chosen.frame), chosen, session.config)
    write_table(folder / f"{session.name}.parquet", table, {"format": DIVIDED_FORMAT, "digest": digest})
