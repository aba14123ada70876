"""LeRobot's own reader gives of an export what is in the log, and what LeRobot's own writer writes is imported.

Skipped unless BC_LEROBOT_PYTHON names a Python that has lerobot 0.6 (`make lerobot-reader`).
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from common.car import CAMERAS
from recorder import Log
from recorder.lerobot.export import export_lerobot
from recorder.sources.import_recording import import_recording
from tests.helpers.lerobot_logs import DRIVES, TIMES_NS, jpeg, steering, write_drives
from tests.helpers.needs import LEROBOT_PYTHON
from tests.helpers.repository import ROOT

PROGRAM: Final = ROOT / "tests" / "helpers" / "lerobot_program.py"
ROWS: Final = range(len(TIMES_NS))

pytestmark = pytest.mark.needs("lerobot")


def run_lerobot(tmp_path: Path, *arguments: object) -> None:
    run_python(tmp_path, PROGRAM, *arguments)


def run_python(tmp_path: Path, *arguments: object) -> None:
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "huggingface")}
    environment.pop("PYTHONPATH", None)
    done = subprocess.run(
        [str(LEROBOT_PYTHON), *map(str, arguments)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]


def read_by_lerobot(tmp_path: Path, folder: Path) -> dict[str, Any]:
    run_lerobot(tmp_path, "read", folder, tmp_path / "read.npz")
    with np.load(tmp_path / "read.npz") as arrays:
        return dict(arrays)


def rgb(picture: bytes) -> Any:
    bgr = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    return bgr[..., ::-1].transpose(2, 0, 1)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lerobot")
    export_lerobot([write_drives(folder / "two.mcap")], folder / "out", task="Stay on the road.")
    return folder / "out"


@pytest.fixture(scope="module")
def read_back(exported: Path) -> dict[str, Any]:
    return read_by_lerobot(exported.parent, exported)


def test_its_batches_have_our_pictures_actions_and_times(read_back: dict[str, Any]) -> None:
    for camera in CAMERAS:
        pictures = read_back[f"observation.images.{camera}"]
        for row in ROWS:
            # two decoders of JPEG may round differently
            assert np.abs(pictures[row].astype(int) - rgb(jpeg(camera, row))).max() <= 3
    expected = np.array([[steering(row), 0.1 * (row % 10), 0.0] for row in ROWS])
    np.testing.assert_array_equal(read_back["action"], expected.astype(np.float32))
    before = np.where(np.isin(ROWS, [drive[0] for drive in DRIVES])[:, None], 0.0, np.roll(expected, 1, axis=0))
    states = np.column_stack([np.full(20, 9.3), before])
    np.testing.assert_array_equal(read_back["observation.state"], states.astype(np.float32))
    assert read_back["log_time_ns"].tolist() == TIMES_NS
    np.testing.assert_array_equal(read_back["log_vehicle"][:, 0], expected[:, 0].astype(np.float32))
    assert read_back["episode_index"].tolist() == [episode for episode, drive in enumerate(DRIVES) for _ in drive]
    assert set(read_back["task"].tolist()) == {"Stay on the road."}


def test_its_windows_end_with_an_episode(read_back: dict[str, Any]) -> None:
    for drive in DRIVES:
        for row in drive:
            wanted = [min(row + step, drive[-1]) for step in range(3)]
            np.testing.assert_array_equal(read_back["windows"][row], read_back["action"][wanted])
            assert read_back["windows_pad"][row].tolist() == [row + step > drive[-1] for step in range(3)]


def test_its_other_readers_and_its_merging_agree(read_back: dict[str, Any]) -> None:
    assert read_back["last_episode"].tolist() == list(DRIVES[1])
    assert sorted(read_back["streamed"].tolist()) == list(ROWS)
    np.testing.assert_array_equal(read_back["merged"], np.concatenate([read_back["action"], read_back["action"]]))


def test_its_statistics_are_ours(read_back: dict[str, Any], exported: Path) -> None:
    (first, _) = pq.read_table(exported / "meta/episodes").to_pylist()
    keys = [key for key in read_back if key.startswith(("stats/action/", "stats/observation.state/"))]
    assert len(keys) == 20
    for key in keys:
        # its quantiles are of the bins of a histogram
        tolerance = 0.3 if key.rpartition("/")[2].startswith("q") else 1e-5
        np.testing.assert_allclose(first[key], read_back[key], atol=tolerance)
    assert read_back["mean_of_pictures"].shape == (3, 1, 1)


def test_its_frames_of_our_videos_are_those_of_the_rows(tmp_path: Path) -> None:
    export_lerobot([write_drives(tmp_path / "two.mcap")], tmp_path / "out", is_video=True)
    read_back = read_by_lerobot(tmp_path, tmp_path / "out")
    originals = [rgb(jpeg("left", row)).astype(int) for row in ROWS]
    for row, picture in enumerate(read_back["observation.images.left"]):
        errors = [np.abs(picture - original).mean() for original in originals]
        assert errors[row] == min(errors) < 12


def test_it_trains_act_on_an_export_and_act_answers_with_an_action(tmp_path: Path, exported: Path) -> None:
    trained = tmp_path / "trained"
    run_python(
        tmp_path,
        *("-m", "lerobot.scripts.lerobot_train", "--dataset.repo_id=own/dataset", f"--dataset.root={exported}"),
        *("--policy.type=act", "--policy.device=cpu", "--policy.push_to_hub=false"),
        "--policy.pretrained_backbone_weights=null",  # they are on the internet
        *("--policy.chunk_size=4", "--policy.n_action_steps=2", "--policy.dim_model=64"),
        *("--steps=2", "--batch_size=4", "--num_workers=0", "--save_freq=2", f"--output_dir={trained}"),
    )
    model = trained / "checkpoints/000002/pretrained_model"
    run_lerobot(tmp_path, "act", exported, model, tmp_path / "actions.npy")
    actions = np.load(tmp_path / "actions.npy")
    assert actions.shape == (len(ROWS), 3)
    assert np.isfinite(actions).all()


@pytest.mark.parametrize("dtype", ["image", "video"])
def test_what_it_writes_is_imported(tmp_path: Path, dtype: str) -> None:
    run_lerobot(tmp_path, "write", tmp_path / "theirs", dtype)
    done = import_recording(tmp_path / "theirs", tmp_path / "theirs.mcap")
    assert (done.rows, done.pictures, list(done.skipped)) == (10, 10, [])
    with Log(done.path) as log:
        vehicle = log.vehicle()
        np.testing.assert_allclose(vehicle["steering"].to_numpy(), -1 + 0.2 * np.arange(10), atol=1e-6)
        assert vehicle["throttle"].to_pylist() == [0.5] * 10
        steps_ns = np.diff(vehicle["log_time_ns"].to_numpy())
        assert steps_ns.tolist() == [50_000_000] * 5 + [10_000_000_000] + [50_000_000] * 3
        for row in range(10):
            red = rgb(log.picture(row))[0].mean()
            assert abs(red - 20 * row) < (0.01 if dtype == "image" else 8)
