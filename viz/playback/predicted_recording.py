"""A log with the predictions of networks, as a Rerun recording."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dataset.preprocessing import Image
from model.evaluation.log_predictions import LogPredictions
from model.evaluation.predict_log import predict_log, run_names
from recorder.topics import STEERING
from viz.playback.attention_overlay import send_overlays
from viz.playback.blueprint import attention_entity, entity_part
from viz.playback.curves import Drawing
from viz.playback.prediction_curves import prediction_curves
from viz.playback.rerun_recording import PredictionLayer, PreparedRecording, prepare_log


@contextlib.contextmanager
def prepare_predictions(
    path: Path,
    runs: Sequence[Path],
    on_found: Callable[[LogPredictions], object],
    *,
    attention: bool = False,
    at_s: float | None = None,
) -> Iterator[PreparedRecording]:
    """Prepare the log at `path` with predictions of the networks of `runs`, made when it is sent: steering,
    errors, the worst moments as events, and with `attention` their attention maps. `on_found` receives them.

    `at_s` is as in `prepare_log`. Raises LogError if the log cannot be read, RunError if a run is given twice;
    sending raises what `predict_log` does.
    """

    def send(recording: rr.RecordingStream, drawing: Drawing, flush: Callable[[], object]) -> None:
        def on_attention(run: str, time_ns: NDArray[np.int64], crops: Image, maps: NDArray[np.float32]) -> None:
            send_overlays(recording, attention_entity(run), drawing.clock, time_ns, crops, maps)

        predictions = predict_log(path, runs, on_attention if attention else None, flush)
        _draw(predictions, recording, drawing)
        flush()
        on_found(predictions)

    with prepare_log(path, PredictionLayer(run_names(runs), attention, send), at_s) as prepared:
        yield prepared


def _draw(predictions: LogPredictions, recording: rr.RecordingStream, drawing: Drawing) -> None:
    for curve, time_ns, values in prediction_curves(predictions):
        drawing.curve(curve, time_ns, values)
        if curve.entity.startswith(STEERING.path):
            drawing.arcs(curve, time_ns, values)
    for run in predictions.predicted:
        if moments := predictions.worst_moments(run):
            times, texts = zip(*moments, strict=True)
            columns = rr.TextLog.columns(text=texts, level=["WARN"] * len(texts))
            recording.send_columns(
                f"/events/worst/{entity_part(run)}", drawing.clock(np.array(times, np.int64)), columns
            )
