"""Store predictions of networks for a recorded log in a new log, with a topic for each run."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from common.files import session_name
from model.evaluation.log_predictions import LogPredictions
from recorder import Log, LogWriter
from recorder.bc_pb2 import Prediction
from recorder.log.session_car import known_max_steering_deg
from recorder.topics import PREDICTIONS


def write_predictions(predictions: LogPredictions, path: Path, *, overwrite: bool = False) -> None:
    """Write predictions to a new log: a topic for each run, and the worst moments as events.

    Raises UserError if `path` exists and may not be overwritten, or cannot be written.
    """
    with LogWriter(path, {"source": "prediction", **predictions.about}, overwrite=overwrite) as writer:
        columns = (predictions.row, predictions.log_time_ns, predictions.recorded, *predictions.predicted.values())
        for row, time_ns, recorded, *predicted in zip(*(column.tolist() for column in columns), strict=True):
            for run, steering in zip(predictions.predicted, predicted, strict=True):
                prediction = Prediction(steering=steering)
                if math.isfinite(recorded):
                    prediction.recorded_steering = recorded
                writer.prediction(run, time_ns, row, prediction)
        for run in predictions.predicted:
            for time_ns, text in predictions.worst_moments(run):
                writer.event(time_ns, text, "WARNING", "prediction")


def prediction_topics(log: Log) -> list[str]:
    kind = Prediction.DESCRIPTOR.full_name
    return [topic for topic, schema in sorted(log.schemas.items())
            if topic.startswith(PREDICTIONS) and schema == kind]  # fmt: skip


def read_predictions(log: Log) -> Iterator[LogPredictions]:
    """The predictions in an open log, one `LogPredictions` for each run. Raises LogError for a damaged log."""
    for topic in prediction_topics(log):
        run = topic.removeprefix(PREDICTIONS)
        rows, times_ns, recorded, predicted = array("q"), array("q"), array("d"), array("d")
        for message, prediction in log.predictions(run):
            rows.append(message.sequence)
            times_ns.append(message.log_time_ns)
            recorded.append(prediction.recorded_steering if prediction.HasField("recorded_steering") else math.nan)
            predicted.append(prediction.steering)
        yield LogPredictions(
            session_name(log.path),
            np.array(rows, np.int64),
            np.array(times_ns, np.int64),
            np.array(recorded, np.float64),
            {run: np.array(predicted, np.float64)},
            max_deg=known_max_steering_deg(log),
        )
