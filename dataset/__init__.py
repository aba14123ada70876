"""From logs to what training reads: preprocessing, the index, steering bins and balance, and the loader."""

from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.index import Indexed, build_index, find_logs, sessions_not_indexed
from dataset.loader import Batch, Loader, Samples
from dataset.preprocess import decode, preprocess
from recorder.topics import MAX_STEERING_DEG

__all__ = [
    "MAX_STEERING_DEG",
    "Batch",
    "DatasetError",
    "IndexConfig",
    "Indexed",
    "Loader",
    "Samples",
    "build_index",
    "decode",
    "find_logs",
    "preprocess",
    "sessions_not_indexed",
]
