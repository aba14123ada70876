"""The settings and curves of trainings in MLflow.

    pip install mlflow        # or mlflow-skinny, without its web page
    bc-train --name first --listener examples/mlflow_listener.py:MlflowListener
    mlflow ui

Where MLflow keeps them is its own setting: MLFLOW_TRACKING_URI, such as sqlite:///mlflow.db or a server's address.
"""

from dataclasses import asdict
from pathlib import Path

import mlflow

from model import Epoch, Step, TrainConfig


class MlflowListener:
    """Each run of ours is a run there; the steps are the samples learnt from."""

    def __init__(self, run: Path, config: TrainConfig) -> None:
        mlflow.set_experiment("driving")
        mlflow.start_run(run_name=run.name)
        mlflow.log_params(asdict(config))
        self._samples = 0

    def step(self, step: Step) -> None:
        self._samples = step.samples
        mlflow.log_metrics(step.scalars, step.samples)

    def epoch(self, epoch: Epoch) -> None:
        mlflow.log_metrics(epoch.scalars, self._samples)

    def close(self) -> None:
        mlflow.end_run()
