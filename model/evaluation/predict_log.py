"""The steering that trained networks predict for every picture of the centre camera in a log.

bc-play run.mcap --run first --run second
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import counted
from common.untrusted import real_path
from dataset.errors import DatasetError
from dataset.loader.crops import LogCrops
from dataset.picture_spec import metadata_of
from dataset.prediction_targets import steering_in
from dataset.preprocessing import Image
from model.errors import RunError
from model.evaluation.log_predictions import LogPredictions
from model.evaluation.predict import BATCH, predict_crops
from model.runs.run_folder import picture_of_run, run_name, weights_checksum

LogAttentionCallback = Callable[[str, NDArray[np.int64], Image, NDArray[np.float32]], object]
"""Receives, for N pictures at a time: the run's name, log times (N,) in ns, crops (N, height, width, 3) BGR, and
attention maps (N, height, width), 0..1 (see visual_backprop.py)."""


def run_names(runs: Sequence[Path]) -> list[str]:
    """Distinct names of runs: their folders' names; for equal names, as much of the path as makes them differ.

    Raises RunError if a run is given twice.
    """
    places = [real_path(run) for run in runs]
    names = [run_name(place) for place in places]
    for name, place in zip(names, places, strict=True):
        if places.count(place) > 1:
            raise RunError(f"{name}: given {counted(places.count(place), 'time')}; give each run once")
    depth = 1
    while len(set(names)) < len(names):
        depth += 1
        names = [
            "/".join(place.parts[-depth:]) if names.count(name) > 1 else name
            for name, place in zip(names, places, strict=True)
        ]
    return names


def predict_log(
    log: Path | str,
    runs: Sequence[Path | str],
    on_attention: LogAttentionCallback | None = None,
    on_batch: Callable[[], object] = lambda: None,
) -> LogPredictions:
    """Predict the steering of some runs' networks for a log, finished or not, in float32, from the same pixels as
    in driving. `on_attention` gets attention maps. `on_batch` is called after each batch, and may raise an
    exception to stop.

    Raises RunError if a run is incomplete, damaged or given twice; LogError for a damaged log; DatasetError for a
    log without a usable picture.
    """
    log, folders = Path(log), [Path(run) for run in runs]
    names = run_names(folders)
    with LogCrops(log) as crops:

        def pass_on(run: int, numbers: NDArray[np.int64], pictures: Image, maps: NDArray[np.float32]) -> None:
            if on_attention is not None:
                on_attention(names[run], crops.log_time_ns[numbers], pictures, maps)

        predicted, is_decoded = predict_crops(
            folders, lambda picture: crops.batches(BATCH, picture), len(crops), on_attention and pass_on, on_batch
        )
        if not is_decoded.any():
            raise DatasetError(
                f"{log}: none of {counted(len(crops), 'picture')} decodes; look with `bc-log check`"
            )
        return LogPredictions(
            crops.session,
            crops.row[is_decoded],
            crops.log_time_ns[is_decoded],
            crops.recorded[is_decoded],
            {name: steering_in(values)[is_decoded] for name, values in zip(names, predicted, strict=True)},
            {
                "log": log.name,
                "log_fingerprint": crops.log.fingerprint,
                **{
                    f"weights_sha256.{name}": weights_checksum(run)
                    for name, run in zip(names, folders, strict=True)
                },
                **_preprocessing(names, folders),
                **crops.about_car,
            },
            crops.skipped,
            crops.log.notice,
            crops.max_steering_deg,
        )


def _preprocessing(names: Sequence[str], runs: Sequence[Path]) -> dict[str, str]:
    """The metadata of the networks' pictures: once if all see the same, else for each run by name."""
    pictures = [picture_of_run(run) for run in runs]
    if len(set(pictures)) == 1:
        return metadata_of(pictures[0])
    return {
        key.replace("preprocessing.", f"preprocessing.{name}.", 1): value
        for name, picture in zip(names, pictures, strict=True)
        for key, value in metadata_of(picture).items()
    }
