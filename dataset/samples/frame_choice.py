"""Choose the frames of a session for an index: frames with a label that no rule leaves out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.car import CAMERAS
from dataset.config import IndexConfig
from dataset.frames.drivers import DRIVERS, is_taken
from dataset.frames.frame_flags import is_excluded, is_unusable
from dataset.frames.frames_file import SPLITS, codes
from dataset.samples.labels import planned_labels
from dataset.samples.samples_format import SessionCounts, SessionLabels
from recorder.rows.causes import NOT_LEARNT
from recorder.rows.condition import lists_with, rows_where


@dataclass(frozen=True)
class FrameChoice:
    """The choice among the N frames of a session, before balancing; arrays (N,)."""

    is_chosen: NDArray[np.bool_]
    is_training: NDArray[np.bool_]
    """A chosen frame that is not for training is for validation."""
    steering: NDArray[np.float64]
    """The steering to learn, for the centre camera."""
    counts: SessionCounts


def choose_frames(frames: pa.Table, config: IndexConfig, labels: SessionLabels) -> FrameChoice:
    """Choose frames by the settings. Raises UsageError if `config.where` is no condition on their columns."""
    split = codes(frames["split"], SPLITS)
    split = np.where((split == 1) & np.isin(frames["row"].to_numpy(), labels.shared_rows), 2, split)
    is_bad = is_unusable(frames)
    is_tagged = is_excluded(frames)
    camera = codes(frames["camera"], CAMERAS)
    is_selected = np.isin(camera, [CAMERAS.index(name) for name in config.cameras])
    if config.where is not None:
        is_selected &= rows_where(frames, config.where)
    is_wanted = is_selected & is_taken(codes(frames["driver"], DRIVERS), config.drives)
    steering, is_odd = planned_labels(frames, labels.plan)
    usable = is_wanted & ~is_bad & ~is_tagged
    has_label = ~np.isnan(steering)
    is_left_out = is_odd & (split != 2)
    left_out = dict[str, int]()
    is_open = usable & is_left_out
    not_measured = int((is_open & (split == 1)).sum())
    for flag in NOT_LEARNT:
        is_flagged = is_open & lists_with(frames["flags"], flag)
        left_out[flag] = int(is_flagged.sum())
        is_open &= ~is_flagged
    chosen = usable & has_label & (split != 2) & ~is_left_out
    counts = SessionCounts(
        frames=len(frames),
        training=int((chosen & (split == 0)).sum()),
        validation=int((chosen & (split == 1)).sum()),
        gap=int((usable & (split == 2)).sum()),
        excluded=int((is_wanted & is_tagged).sum()),
        unusable=int((is_wanted & is_bad & ~is_tagged).sum()),
        unlabelled=int((usable & ~has_label & (split != 2) & ~is_left_out).sum()),
        not_asked_for=int((~is_selected).sum()),
        crashed=left_out["crash"],
        not_taken_over=int((is_selected & ~is_wanted).sum()),
        backwards=left_out["backwards"],
        manoeuvring=left_out["manoeuvring"],
        parked=left_out["parked"],
        not_measured=not_measured,
    )
    return FrameChoice(chosen, split == 0, steering, counts)
