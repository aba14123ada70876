"""The network: its layers, its training, the run folder that keeps it, and the pilot that steers with it.

    from pathlib import Path

    from dataset import decode
    from model import TrainConfig, evaluate, load_pilot, train

    train("index", "runs/first", TrainConfig(epochs=10))
    print(evaluate("runs/first", "index").frames)
    pilot = load_pilot("runs/first")
    steering = pilot.predict(pilot.crop(decode(Path("frame.jpg").read_bytes())))  # -1 left .. 1 right

train           trains a network on an index and keeps it as a run; a Listener receives its Steps and Epochs
evaluate        measures a run on the frames that were held out
judge           the Verdict on a run, with its Advice
find_run        a run by name, or the newest one
load_pilot      the Pilot of a run: steering for a picture
predict_log     what runs would have steered in a log
export_onnx     a run's network for ONNX Runtime
"""

from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from model.config import TrainConfig as TrainConfig
    from model.errors import RunError as RunError
    from model.evaluation.evaluate import Evaluation as Evaluation
    from model.evaluation.evaluate import evaluate as evaluate
    from model.evaluation.log_predictions import LogPredictions as LogPredictions
    from model.evaluation.predict_log import predict_log as predict_log
    from model.onnx_export import export_onnx as export_onnx
    from model.pilot import Pilot as Pilot
    from model.pilot import load_pilot as load_pilot
    from model.runs.advice import Advice as Advice
    from model.runs.run_folder import find_run as find_run
    from model.runs.run_summary import judge as judge
    from model.runs.training_progress import Epoch as Epoch
    from model.runs.training_progress import Listener as Listener
    from model.runs.training_progress import Step as Step
    from model.runs.verdict import Verdict as Verdict
    from model.training.trainer import Trained as Trained
    from model.training.trainer import train as train

_HOMES = {
    "Advice": "model.runs.advice",
    "Epoch": "model.runs.training_progress",
    "Evaluation": "model.evaluation.evaluate",
    "Listener": "model.runs.training_progress",
    "LogPredictions": "model.evaluation.log_predictions",
    "Pilot": "model.pilot",
    "RunError": "model.errors",
    "Step": "model.runs.training_progress",
    "TrainConfig": "model.config",
    "Trained": "model.training.trainer",
    "Verdict": "model.runs.verdict",
    "evaluate": "model.evaluation.evaluate",
    "export_onnx": "model.onnx_export",
    "find_run": "model.runs.run_folder",
    "judge": "model.runs.run_summary",
    "load_pilot": "model.pilot",
    "predict_log": "model.evaluation.predict_log",
    "train": "model.training.trainer",
}
__all__ = [*_HOMES]
__getattr__, __dir__ = lazy_names(__name__, _HOMES)
