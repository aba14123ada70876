"""`index/samples.parquet`: the balanced index that training reads, one row for each sample.

It is built without loading all frames files at the same time: balancing needs one number for each frame, and the
samples are written session by session.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common import atomic_file
from common.car import CAMERAS
from common.errors import first_of
from dataset.config import CORRECTION_SIGNS, IndexConfig
from dataset.errors import DatasetError
from dataset.frames.frames_file import codes, read_frames
from dataset.parquet_file import METADATA_KEY
from dataset.samples.labels import planned_speed_mph, recorded_throttle
from dataset.samples.sample_choice import ChosenSamples, choose_frames, choose_samples
from dataset.samples.samples_format import SAMPLES_FORMAT, SAMPLES_SCHEMA, Balance, SessionCounts, SessionLabels
from dataset.steering_bins import bin_of
from recorder.log.tags import EXCLUDE
from recorder.rows.causes import CAUSES, NOT_LEARNT

FROM_FRAMES: Final = ("session", "row", "camera", "log_time_ns", "offset", "length", "chunk", "split")


@dataclass(frozen=True)
class _UsableFrames:
    """The usable frames of a session; arrays of the same length."""

    position: NDArray[np.int32]  # in the frames file
    label: NDArray[np.float64]  # of the frame's camera, not mirrored
    recorded: NDArray[np.float64]  # the recorded steering, with the same correction for the camera
    is_training: NDArray[np.bool_]
    later_speed_mph: NDArray[np.float64]
    throttle: NDArray[np.float64]  # minus the brake

    def taken(self, frame: NDArray[np.int64]) -> _UsableFrames:
        """The frames at these positions, which may be repeated."""
        return _UsableFrames(*(column[frame] for column in vars(self).values()))


def write_samples(
    frames: Mapping[str, Path],
    path: Path,
    config: IndexConfig,
    logs: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, SessionLabels],
) -> tuple[Balance, dict[str, SessionCounts]]:
    """Write the samples of some sessions' frames files, with mirror images and labels. The training split is
    balanced.

    Validation has every picture and its mirror image once, unaltered. `logs` (session to log and fingerprint) and
    `labels` are written to the file's metadata. Raises DatasetError if no frame can be used.
    """
    sessions: list[_UsableFrames] = []
    counts: dict[str, SessionCounts] = {}
    slower_mph = _slower_set_speeds_mph(labels)
    for name, file in frames.items():
        session, counts[name] = _usable_frames(read_frames(file), config, labels[name], slower_mph[name])
        sessions.append(session)
    sizes = np.array([len(session.position) for session in sessions], np.int64)
    if not sizes.sum():
        raise _nothing_usable(config, counts)
    label = np.concatenate([session.label for session in sessions])
    is_training = np.concatenate([session.is_training for session in sessions])
    chosen, balanced = choose_samples(label, is_training, config)
    del label, is_training
    metadata = {
        "format": SAMPLES_FORMAT,
        "settings": asdict(config),
        "logs": {name: dict(source) for name, source in logs.items()},
        "labels": {name: asdict(of_session) for name, of_session in labels.items()},
        "balance": balanced.as_dict(),
        "counts": {name: asdict(count) for name, count in counts.items()},
    }
    stored = {METADATA_KEY: json.dumps(metadata, sort_keys=True).encode()}
    ends = np.searchsorted(chosen.frame, np.cumsum(sizes))
    starts = np.concatenate([[0], ends[:-1]])
    written: Future[None] | None = None
    with (
        atomic_file(path, overwrite=True) as part,
        pq.ParquetWriter(
            part, SAMPLES_SCHEMA.with_metadata(stored), compression="zstd", write_page_checksum=True
        ) as writer,
        ThreadPoolExecutor(1) as thread,  # compresses the samples of a session while those of the next are made
    ):
        for file, session, first_frame, start, end in zip(
            frames.values(), sessions, np.cumsum(sizes) - sizes, starts.tolist(), ends.tolist(), strict=True
        ):
            if end > start:
                part_of = chosen.between(start, end)
                frame = part_of.frame - first_frame
                taken = read_frames(file, FROM_FRAMES).take(pa.array(session.position[frame]))
                table = _samples_table(taken, session.taken(frame), part_of, config)
                if written is not None:
                    written.result()
                written = thread.submit(writer.write_table, table)
        if written is not None:
            written.result()
    return balanced, counts


def _slower_set_speeds_mph(labels: Mapping[str, SessionLabels]) -> dict[str, list[float]]:
    """The set speeds of each session's driver that are below the highest set speed of all
    (`planned_speed_mph`)."""
    speeds_mph = {name: session_labels.set_speeds_mph for name, session_labels in labels.items()}
    fastest_mph = max((mph for session_mph in speeds_mph.values() for mph in session_mph), default=0.0)
    return {name: [mph for mph in session_mph if mph < fastest_mph] for name, session_mph in speeds_mph.items()}


def _nothing_usable(config: IndexConfig, counts: Mapping[str, SessionCounts]) -> DatasetError:
    chosen = " or not chosen by --where" if config.where is not None else ""
    shift = f" with --label-shift {config.label_shift_s:g}" if config.label_shift_s else ""
    reasons = {
        "not_asked_for": f"not of a camera {' or '.join(config.cameras)}{chosen}",
        "not_taken_over": (
            "driven by the network, not taken over (--drives takeovers; Udacity's simulator sends no pictures"
            " while a person holds keys: record in its training mode, or take over with `bc-drive --takeover me`)"
        ),
        "excluded": f"tagged {EXCLUDE}",
        "unusable": "with a broken picture, or steering outside -1..1",
        "unlabelled": f"too near the end of a stretch for a label{shift}",
        "gap": "between training and validation",
    }
    totals = {name: sum(getattr(count, name) for count in counts.values()) for name in reasons}
    for name in NOT_LEARNT:
        reasons[name] = f"of {CAUSES[name].of_frames}"
        totals[name] = sum(count.not_learnt[name] for count in counts.values())
    frames = ", ".join(f"{totals[name]:,} {reason}" for name, reason in reasons.items() if totals[name])
    names = first_of([f"{name}.mcap" for name in counts])
    return DatasetError(f"no frame can be used: {frames or f'no picture in {names}; look with `bc-log check`'}")


def _usable_frames(
    frames: pa.Table, config: IndexConfig, labels: SessionLabels, slower_mph: Sequence[float]
) -> tuple[_UsableFrames, SessionCounts]:
    choice = choose_frames(frames, config, labels)
    at = np.flatnonzero(choice.is_chosen)
    camera = codes(frames["camera"], CAMERAS)
    label = _of_camera(choice.steering[at], camera[at], config)
    recorded = _of_camera(frames["steering"].to_numpy()[at], camera[at], config)
    usable = _UsableFrames(
        at.astype(np.int32),
        label,
        recorded,
        choice.is_training[at],
        planned_speed_mph(frames, labels.plan, config.speed_ahead_s, slower_mph)[at],
        recorded_throttle(frames)[at],
    )
    return usable, choice.counts


def _of_camera(
    steering: NDArray[np.float64], camera: NDArray[np.int8], config: IndexConfig
) -> NDArray[np.float64]:
    """Correct the steering (N,) for the camera of each frame: -1..1, never -0.0."""
    signs = np.array([CORRECTION_SIGNS.get(name, 0.0) for name in CAMERAS])
    return np.clip(steering + config.side_correction * signs[camera], -1.0, 1.0) + 0.0


def _samples_table(
    frames: pa.Table, session: _UsableFrames, chosen: ChosenSamples, config: IndexConfig
) -> pa.Table:
    """The samples of one session. `frames` and `session` have one row for each sample."""
    combinations = [
        "+".join(name for i, name in enumerate(config.alterations) if bits >> i & 1)
        for bits in range(1 << len(config.alterations))
    ]
    label, recorded = (
        np.where(chosen.flip, -steering, steering) + 0.0 for steering in (session.label, session.recorded)
    )
    columns = {
        **{name: frames[name] for name in FROM_FRAMES},
        "flip": chosen.flip,
        "alteration": pa.DictionaryArray.from_arrays(chosen.alteration, combinations),
        "seed": chosen.seed,
        "label": label,
        "recorded": recorded,
        "bin": bin_of(label, config.bins),
        "copy": chosen.is_copy,
        "later_speed_mph": pa.array(session.later_speed_mph, from_pandas=True),  # NaN to null
        "throttle": pa.array(session.throttle, from_pandas=True),
    }
    return pa.table({field.name: columns[field.name] for field in SAMPLES_SCHEMA}).cast(SAMPLES_SCHEMA)
