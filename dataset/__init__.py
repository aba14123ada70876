"""The way from logs to training: preprocessing, the index, steering bins and balance, and the loader."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.car import MAX_STEERING_DEG
from common.lazy import lazy_names
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.loader.loader import Batch, Loader, load
from dataset.loader.torch_dataset import SamplesDataset
from dataset.preprocess import decode, preprocess
from dataset.samples.samples_reader import Samples

if TYPE_CHECKING:
    from dataset.index.build import Indexed, build_index
    from dataset.index.sessions import find_logs, sessions_not_indexed

__all__ = [
    "MAX_STEERING_DEG",
    "Batch",
    "DatasetError",
    "IndexConfig",
    "Indexed",
    "Loader",
    "Samples",
    "SamplesDataset",
    "build_index",
    "decode",
    "find_logs",
    "load",
    "preprocess",
    "sessions_not_indexed",
]

# training reads an index where what builds one is not installed
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Indexed": "dataset.index.build",
        "build_index": "dataset.index.build",
        "find_logs": "dataset.index.sessions",
        "sessions_not_indexed": "dataset.index.sessions",
    },
)
