"""The network: its layers, its training, the run folder that keeps it, and the pilot that steers with it."""

from model.config import TrainConfig
from model.errors import RunError
from model.pilot import Pilot, load_pilot
from model.run import find_run
from model.train import Epoch, train

__all__ = ["Epoch", "Pilot", "RunError", "TrainConfig", "find_run", "load_pilot", "train"]
