"""The network: its layers, its training, the run folder that keeps it, and the pilot that steers with it."""

from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from model.config import TrainConfig
    from model.errors import RunError
    from model.pilot import Pilot, load_pilot
    from model.run import find_run
    from model.training import Epoch, train

__all__ = ["Epoch", "Pilot", "RunError", "TrainConfig", "find_run", "load_pilot", "train"]

__getattr__ = lazy_names(
    __name__,
    {
        "Epoch": "model.training",
        "Pilot": "model.pilot",
        "RunError": "model.errors",
        "TrainConfig": "model.config",
        "find_run": "model.run",
        "load_pilot": "model.pilot",
        "train": "model.training",
    },
)
