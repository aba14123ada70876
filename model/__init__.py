"""The network: its layers, its training, the run folder that keeps it, and the pilot that steers with it."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from model.config import TrainConfig
    from model.errors import RunError
    from model.evaluation.evaluate import Evaluation, evaluate
    from model.evaluation.log_predictions import LogPredictions
    from model.evaluation.predict_log import predict_log
    from model.onnx_export import export_onnx
    from model.pilot import Pilot, load_pilot
    from model.runs.advice import Advice
    from model.runs.run_folder import find_run
    from model.runs.run_summary import judge
    from model.runs.training_progress import Epoch, Listener, Step
    from model.runs.verdict import Verdict
    from model.training.trainer import Trained, train

__all__ = [
    "Advice",
    "Epoch",
    "Evaluation",
    "Listener",
    "LogPredictions",
    "Pilot",
    "RunError",
    "Step",
    "TrainConfig",
    "Trained",
    "Verdict",
    "evaluate",
    "export_onnx",
    "find_run",
    "judge",
    "load_pilot",
    "predict_log",
    "train",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
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
    },
)
