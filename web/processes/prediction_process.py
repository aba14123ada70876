"""The process in which a run's network predicts a whole log. It reports progress on stdout, and writes a file.

It is separate, because a network uses all processors for a while and would delay the pages. It runs no user's own
network code.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from common.errors import printable
from common.location import location
from model.evaluation.predict import BATCH
from model.evaluation.predict_log import predict_log
from model.metrics import measure
from recorder.log_copy_cli import brought_here
from web.errors import WebError
from web.processes.kept_work import write_result
from web.processes.own_process import counter, run_in_process
from web.processes.predictions import Measured, WorstMoment

_WORST: Final = 30  # moments in the list
_NICENESS: Final = 5


def main() -> None:
    run_in_process(_work, _NICENESS)


def _work(log: str, run: str, fingerprint: str, result: str) -> None:
    with brought_here([location(log)]) as (path,):
        predictions = predict_log(path, [Path(run)], on_batch=counter(BATCH))
    if predictions.about["log_fingerprint"] != fingerprint:
        raise WebError("the log has been replaced since this page was opened: reload it")
    [(name, predicted)] = predictions.predicted.items()
    is_recorded = np.isfinite(predictions.recorded)
    measured = measure(predicted[is_recorded], predictions.recorded[is_recorded], max_deg=predictions.max_deg)
    about = Measured(
        frames=measured.frames,
        rmse_deg=measured.network.rmse_deg if measured.frames else None,
        mean_rmse_deg=measured.mean.rmse_deg if measured.frames else None,
        max_deg=predictions.max_deg,
        worst=[
            WorstMoment(worst.row, worst.error_deg, worst.predicted_deg, worst.recorded_deg)
            for worst in predictions.worst(name, _WORST)
        ],
        notes=[printable(line) for line in (*predictions.skipped.lines(), predictions.notice) if line],
    )
    encoded = np.frombuffer(msgspec.json.encode(about), np.uint8)
    write_result(Path(result), row=predictions.row, predicted=predicted, about=encoded)
