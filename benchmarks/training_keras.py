"""The same training in Keras on TensorFlow, as in the original project. It does not need this toolkit.

python benchmarks/training_keras.py PICTURES [--precision mixed_bfloat16] [--no-xla] [--threads 1] < turns

PICTURES is a folder of JPEG files with a list of samples, as training.py writes it. For each line on stdin, it
trains an epoch with `fit` and prints its seconds. Needs `pip install tensorflow opencv-python-headless`.
"""

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import keras  # type: ignore[import-not-found]
import numpy as np
import tensorflow as tf  # type: ignore[import-untyped]
from keras import layers

PARAMETERS = 5_022_327
BATCH = 256


class Pictures(keras.utils.PyDataset):  # type: ignore[misc]
    """Batches that are read, cropped and resized on demand, with Keras' default workers."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        with (folder / "samples.csv").open(newline="") as stream:
            self.samples = [
                (str(folder / name), flip == "1", float(steering)) for name, flip, steering in csv.reader(stream)
            ]
        self.random = np.random.default_rng(0)
        self.on_epoch_end()

    def __len__(self) -> int:
        return -(-len(self.samples) // BATCH)

    def __getitem__(self, number: int) -> tuple[Any, Any]:
        chosen = self.order[number * BATCH : (number + 1) * BATCH]
        pictures = np.empty((len(chosen), 128, 128, 3), np.float32)
        for picture, at in zip(pictures, chosen, strict=True):
            path, flip, _ = self.samples[at]
            whole: Any = cv2.imread(path)
            crop = cv2.resize(whole[50:-20], (128, 128))
            picture[:] = cv2.flip(crop, 1) if flip else crop
        return pictures, np.array([self.samples[at][2] for at in chosen], np.float32)

    def on_epoch_end(self) -> None:
        self.order = self.random.permutation(len(self.samples))


class Turns(keras.callbacks.Callback):  # type: ignore[misc]
    """Begins an epoch for each line on stdin, and exits at its end."""

    def on_epoch_begin(self, epoch: int, logs: Any = None) -> None:
        if not sys.stdin.readline():
            raise SystemExit
        self.start_s = time.perf_counter()

    def on_epoch_end(self, epoch: int, logs: Any = None) -> None:
        print(time.perf_counter() - self.start_s, flush=True)


def network() -> Any:
    """The original project's network, layer by layer."""
    return keras.Sequential(
        [
            layers.Input((128, 128, 3)),
            layers.Rescaling(1 / 127.5, -1),
            layers.Conv2D(24, 5, activation="relu"),
            layers.MaxPooling2D(),
            layers.Conv2D(36, 5, activation="relu"),
            layers.MaxPooling2D(),
            layers.Conv2D(48, 5, activation="relu"),
            layers.MaxPooling2D(),
            layers.Conv2D(64, 3, activation="relu"),
            layers.Conv2D(64, 3, activation="relu"),
            layers.Flatten(),
            layers.Dropout(0.5),
            layers.Dense(1164, activation="relu"),
            layers.Dropout(0.5),
            layers.Dense(100, activation="relu"),
            layers.Dense(50, activation="relu"),
            layers.Dense(10, activation="relu"),
            layers.Dense(1, dtype="float32"),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", type=Path)
    parser.add_argument("--precision", default="float32", choices=["float32", "mixed_bfloat16"])
    parser.add_argument("--no-xla", action="store_true", help="do not compile; by default Keras compiles")
    parser.add_argument("--threads", type=int, default=0, help="threads of TensorFlow's operators; 0: all cores")
    chosen = parser.parse_args()
    tf.config.threading.set_intra_op_parallelism_threads(chosen.threads)
    tf.config.threading.set_inter_op_parallelism_threads(chosen.threads)
    keras.mixed_precision.set_global_policy(chosen.precision)
    model = network()
    if model.count_params() != PARAMETERS:
        raise SystemExit(f"{model.count_params():,} parameters, not {PARAMETERS:,}: not the same network")
    compiled = {"jit_compile": False} if chosen.no_xla else {}
    model.compile(optimizer=keras.optimizers.Adam(1e-4), loss="mse", **compiled)
    model.fit(Pictures(chosen.pictures), epochs=1_000_000, verbose=0, callbacks=[Turns()])


if __name__ == "__main__":
    main()
