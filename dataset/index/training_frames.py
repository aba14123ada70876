"""The frames of a log that were for training: a network must not be measured by what it has learnt."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.car import CAMERAS
from dataset.config import IndexConfig
from dataset.frames.frames_table import driven_states, frames_of
from dataset.frames.pairing import moments
from recorder import Log
from recorder.topics import camera_topic


def is_for_training(frames: pa.Table, log: Log, session: str, config: IndexConfig) -> NDArray[np.bool_]:
    """A mask of the `frames` of a log (N,) that are on the training side of an index which was made with `config`
    and called the log `session`. `frames` needs the columns row and log_time_ns.

    The split is computed anew from the log. It depends on neither tags nor cameras nor --where: frames that these
    kept from training count as for it.
    """
    states, driver = driven_states(log)
    pictures = {camera: log.pictures(camera_topic(camera)) for camera in CAMERAS}
    indexed = frames_of(states, pictures, session, config, driver=driver)
    return np.isin(moments(frames), moments(indexed.filter(pc.equal(indexed["split"], "train"))))
