"""The network: its layers, its training, the run folder that keeps it, and the pilot that steers with it."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from model.config import TrainConfig
    from model.errors import RunError
    from model.evaluation import Evaluation, evaluate
    from model.export import export_onnx
    from model.pilot import Pilot, load_pilot
    from model.predictions import LogPredictions
    from model.progress import Epoch, Listener, Step
    from model.replay import predict_log
    from model.run import find_run
    from model.training import Trained, train

__all__ = [
    "Epoch",
    "Evaluation",
    "Listener",
    "LogPredictions",
    "Pilot",
    "RunError",
    "Step",
    "TrainConfig",
    "Trained",
    "evaluate",
    "export_onnx",
    "find_run",
    "load_pilot",
    "predict_log",
    "train",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Epoch": "model.progress",
        "Evaluation": "model.evaluation",
        "Listener": "model.progress",
        "LogPredictions": "model.predictions",
        "Pilot": "model.pilot",
        "RunError": "model.errors",
        "Step": "model.progress",
        "TrainConfig": "model.config",
        "Trained": "model.training",
        "evaluate": "model.evaluation",
        "export_onnx": "model.export",
        "find_run": "model.run",
        "load_pilot": "model.pilot",
        "predict_log": "model.replay",
        "train": "model.training",
    },
)
