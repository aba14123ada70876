"""From logs to training: preprocessing, the index, steering bins and balance, and the loader.

    from dataset import IndexConfig, build_index, find_logs, load

    build_index(find_logs([], "sessions"), "index", IndexConfig(cameras=("center",)))
    with load("index", "train", batch=256) as loader:
        for batch in loader.epoch(0):
            print(batch.pictures.shape, batch.steering)

find_logs               find the logs of a folder, or of sessions by name
build_index             update an index of logs
sessions_not_indexed    list the logs that an index does not contain yet
load                    load a split of an index in batches; SamplesDataset is the same for PyTorch's DataLoader
Samples                 the samples of an index as a table, and their pictures
decode, preprocess      decode a JPEG, and convert the picture to the network's input
"""

from typing import TYPE_CHECKING

from common.car import MAX_STEERING_DEG
from common.lazy import lazy_names
from dataset.config import IndexConfig
from dataset.errors import DatasetError

if TYPE_CHECKING:
    from dataset.index.build import Indexed as Indexed
    from dataset.index.build import build_index as build_index
    from dataset.index.sessions import find_logs as find_logs
    from dataset.index.sessions import sessions_not_indexed as sessions_not_indexed
    from dataset.loader.loader import Batch as Batch
    from dataset.loader.loader import Loader as Loader
    from dataset.loader.loader import SamplesDataset as SamplesDataset
    from dataset.loader.loader import load as load
    from dataset.preprocessing import decode as decode
    from dataset.preprocessing import preprocess as preprocess
    from dataset.samples.samples_reader import Samples as Samples

# imported on first use: training needs fewer packages than building an index; flags and errors need no NumPy
_HOMES = {
    "Batch": "dataset.loader.loader",
    "Indexed": "dataset.index.build",
    "Loader": "dataset.loader.loader",
    "Samples": "dataset.samples.samples_reader",
    "SamplesDataset": "dataset.loader.loader",
    "build_index": "dataset.index.build",
    "decode": "dataset.preprocessing",
    "find_logs": "dataset.index.sessions",
    "load": "dataset.loader.loader",
    "preprocess": "dataset.preprocessing",
    "sessions_not_indexed": "dataset.index.sessions",
}
__all__ = ["MAX_STEERING_DEG", "DatasetError", "IndexConfig", *_HOMES]
__getattr__, __dir__ = lazy_names(__name__, _HOMES)
