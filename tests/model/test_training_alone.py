"""Training needs few of the packages that are installed with the toolkit: no viewer, no server, no Protobuf."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest

from dataset import IndexConfig, build_index
from tests.helpers.driving import PATIENCE_S, environment, road_jpeg
from tests.helpers.logs import write_log

NEEDED = ("torch", "numpy", "opencv-python-headless", "pyarrow", "safetensors", "mcap", "msgspec", "rich", "tyro")
OURS = "behavioural-cloning-toolkit"

TRAINING = '''
import json, sys
from pathlib import Path

refused = set(json.load(sys.stdin))

class Without:
    """A finder of modules that does not find those."""

    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in refused:
            return None
        return self.finder.find_spec(name, path, target)

    def __getattr__(self, name):  # importlib.metadata asks more of it
        return getattr(self.finder, name)

sys.meta_path[:] = map(Without, sys.meta_path)

import numpy as np
from dataset import Samples, SamplesDataset, load
from model import TrainConfig, load_pilot, train

index, run, other_index = map(Path, sys.argv[2:])
config = TrainConfig(network=sys.argv[1], epochs=1, batch=16, threads=1)
train(index, run, config)
print(*train(other_index, run.with_name("tuned"), config, init=run).notices)
pilot = load_pilot(run)
assert -2 < pilot.predict(np.zeros(pilot.picture.shape, np.uint8)) < 2
with load(index, batch=16) as loader:
    first = next(loader.epoch(1))
    print(len(loader), first.pictures.shape, len(SamplesDataset(index)))
'''


def installed_with(names: tuple[str, ...]) -> set[str]:
    """The distributions of these names and all that they require: lz4 and zstandard with mcap; with torch
    filelock, fsspec, jinja2, networkx, setuptools, sympy, typing-extensions; on some machines those of CUDA."""
    names_with_needs: set[str] = set()
    waiting = [*names]
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name in names_with_needs:
            continue
        names_with_needs.add(name)
        try:
            needed = requires(name) or []
        except PackageNotFoundError:  # of another system, or another Python
            continue
        waiting += [re.split(r"[^\w.-]", line)[0] for line in needed if "extra ==" not in line]
    return names_with_needs


@pytest.mark.parametrize("network", ["small", pytest.param("original", marks=pytest.mark.long)])
def test_training_runs_where_nothing_else_is_installed(network: str, tmp_path: Path) -> None:
    steering = [(row % 21 - 10) / 10 for row in range(60)]
    log = write_log(tmp_path / "road.mcap", steering, lambda camera, row: road_jpeg(row), cameras=["center"])
    index = build_index([log], tmp_path / "index", IndexConfig(block_s=1.0, gap_s=0.1)).path
    split_otherwise = build_index([log], tmp_path / "other", IndexConfig(block_s=0.5, gap_s=0.1)).path
    allowed = installed_with(NEEDED) | {OURS}
    refused = [
        module
        for module, owners in packages_distributions().items()
        if allowed.isdisjoint(re.sub(r"[-_.]+", "-", owner).lower() for owner in owners)
    ]
    assert {"foxglove_schemas_protobuf", "google", "mcap_protobuf", "rerun"} <= set(refused)
    done = subprocess.run(
        [sys.executable, "-c", TRAINING, network, str(index), str(tmp_path / "run"), str(split_otherwise)],
        input=json.dumps(refused),
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    assert f"{tmp_path / 'run'}: whether it has learnt from the frames held out is unknown (" in done.stdout
    samples, shape, _ = done.stdout.splitlines()[-1].partition(" (16, 128, 128, 3) ")
    assert shape
    assert int(samples) > 16
