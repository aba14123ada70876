"""A log with the predictions and the attention maps of networks, as a Rerun recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dataset.preprocessing import Image
from model.evaluation.log_predictions import LogPredictions
from model.evaluation.predict_log import predict_log, run_names
from recorder.topics import STEERING
from viz.playback.blueprint import attention_entity
from viz.playback.curves import Drawing, prediction_curves
from viz.playback.log_chunks import picture_columns
from viz.playback.rerun_recording import PredictionLayer, PreparedRecording, prepare_log

QUALITY: Final = 90  # of the JPEGs, some 7 KB each

_COLOR: Final = np.array((230, 40, 255), np.float32)  # BGR; no road has this colour
_MAX_COVER: Final = 0.8  # share of the colour where the map is 1
_DIMMED: Final = 0.8  # the picture's brightness


def prepare_predictions(
    path: Path,
    runs: Sequence[Path],
    on_predictions: Callable[[LogPredictions], object],
    *,
    attention: bool = False,
    at_s: float | None = None,
) -> AbstractContextManager[PreparedRecording]:
    """Prepare the log at `path` with predictions of the networks of `runs`: steering, errors, the worst moments as
    events, and with `attention` the attention maps. They are made while the recording is sent, and then given to
    `on_predictions`.

    `at_s` is as in `prepare_log`. Raises LogError if the log cannot be read, RunError if a run is given twice;
    sending raises what `predict_log` raises.
    """

    def send(recording: rr.RecordingStream, drawing: Drawing, flush: Callable[[], object]) -> None:
        def on_attention(run: str, time_ns: NDArray[np.int64], crops: Image, maps: NDArray[np.float32]) -> None:
            settings = (cv2.IMWRITE_JPEG_QUALITY, QUALITY)
            jpegs = [cv2.imencode(".jpg", picture, settings)[1].tobytes() for picture in overlay(crops, maps)]
            columns = picture_columns(jpegs, ["jpeg"] * len(jpegs))
            recording.send_columns(attention_entity(run), drawing.clock(time_ns), columns)

        predictions = predict_log(path, runs, on_attention if attention else None, flush)
        _draw(predictions, recording, drawing)
        flush()
        on_predictions(predictions)

    return prepare_log(path, PredictionLayer(run_names(runs), attention, send), at_s)


def _draw(predictions: LogPredictions, recording: rr.RecordingStream, drawing: Drawing) -> None:
    for curve, time_ns, values in prediction_curves(predictions):
        drawing.curve(curve, time_ns, values)
        if curve.entity.startswith(STEERING.path):
            drawing.arcs(curve, time_ns, values)
    for run in predictions.predicted:
        if moments := predictions.worst_moments(run):
            times, texts = zip(*moments, strict=True)
            columns = rr.TextLog.columns(text=texts, level=["WARN"] * len(texts))
            entity = f"/events/worst/{rr.escape_entity_path_part(run)}"
            recording.send_columns(entity, drawing.clock(np.array(times, np.int64)), columns)


def overlay(crops: Image, maps: NDArray[np.float32]) -> Image:
    """Draw maps (N, height, width), 0..1, over dimmed crops (N, height, width, 3) BGR. Where the map is higher, a
    colour covers more of the crop."""
    share = _MAX_COVER * maps[..., None]
    blended = crops * (_DIMMED * (1 - share)) + _COLOR * share
    return blended.astype(np.uint8)
