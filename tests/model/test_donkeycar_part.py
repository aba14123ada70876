"""`bc-train export RUN --donkeycar FOLDER`: a network that takes the camera's picture, and DonkeyCar's part."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
from onnx import TensorProto, helper

from dataset import decode
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import preprocess
from model import load_pilot
from model.cli import main
from model.network.choice import built_in
from model.onnx_export import IR_VERSION, OPSET, export_onnx
from tests.helpers.driving import PATIENCE_S, environment, road_jpeg, untrained_run
from tests.helpers.udacity import call

pytestmark = pytest.mark.usefixtures("exported_once")

ALONE = (
    "import sys\n"
    "ours = ['common', 'simulator', 'recorder', 'dataset', 'model', 'viz', 'drive', 'torch', 'cv2', 'onnx']\n"
    "sys.modules.update(dict.fromkeys(ours))\n"
    "sys.path.insert(0, sys.argv[1])\n"
    "import numpy\n"
    "from donkeycar_part import OnnxPilot\n"
    "print(*OnnxPilot(sys.argv[2], throttle=0.25).run(numpy.load(sys.argv[3])))\n"
)


@pytest.fixture(scope="module")
def road() -> Any:
    """A road as the camera sees it: (160, 320, 3), RGB."""
    return np.ascontiguousarray(decode(road_jpeg(8))[..., ::-1])


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that predicts a throttle, and whose crop is in other colours than the camera's picture."""
    runs = tmp_path_factory.mktemp("runs")
    return untrained_run(runs / "first", targets=("steering", "throttle"), network="pilotnet")


@pytest.fixture(scope="module")
def car(trained: Path) -> Path:
    folder = trained.parent / "car"
    assert call(main, "export", trained, "--donkeycar", folder) == 0
    return folder


def write_onnx(path: Path, taken: str) -> Path:
    """A network whose only input has this name, and which answers nothing but steering."""
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N"]) for name in (taken, "steering")]
    graph = helper.make_graph([helper.make_node("Relu", [taken], ["steering"])], "steers", values[:1], values[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    path.write_bytes(model.SerializeToString())
    return path


def part_of(folder: Path) -> Any:
    spec = importlib.util.spec_from_file_location("donkeycar_part", folder / "donkeycar_part.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pilot_class(car: Path) -> Any:
    return part_of(car).OnnxPilot


def answers(run: Path, picture: Any) -> list[float]:
    """Steering and throttle of the toolkit's own pilot, between -1 and 1."""
    pilot = load_pilot(run, "float32")
    answer = pilot.answer(pilot.crop(np.ascontiguousarray(picture[..., ::-1])))
    assert answer.throttle is not None
    return [max(-1.0, min(value, 1.0)) for value in (answer.steering, answer.throttle)]


def test_it_drives_as_the_pilot_with_only_numpy_and_onnx_runtime(
    trained: Path, car: Path, road: Any, tmp_path: Path
) -> None:
    np.save(tmp_path / "road.npy", road)
    line = [sys.executable, "-I", "-c", ALONE, str(car), str(car / "first.onnx"), str(tmp_path / "road.npy")]
    done = subprocess.run(line, env=environment(), capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    steering, throttle = map(float, done.stdout.split())
    assert steering == pytest.approx(answers(trained, road)[0], abs=0.02)
    assert throttle == 0.25


def test_the_throttle_is_the_networks_unless_one_is_given(
    trained: Path, car: Path, pilot_class: Any, road: Any
) -> None:
    assert pilot_class(car / "first.onnx").run(road) == pytest.approx(answers(trained, road), abs=0.02)
    assert pilot_class(car / "first.onnx", throttle=-0.5).run(road)[1] == -0.5


def test_a_network_without_throttle_needs_one(tmp_path: Path, pilot_class: Any) -> None:
    steering_only = write_onnx(tmp_path / "only.onnx", "picture")
    with pytest.raises(ValueError, match=r"only\.onnx predicts no throttle: give one, as in OnnxPilot\("):
        pilot_class(steering_only)
    with pytest.raises(ValueError, match="throttle 20: expected -1 to 1"):
        pilot_class(steering_only, throttle=20)


def test_a_file_of_another_export_is_refused(tmp_path: Path, pilot_class: Any) -> None:
    """Its input is "pictures", as test_onnx_export.py shows."""
    with pytest.raises(ValueError, match="`bc-train export RUN --donkeycar`"):
        pilot_class(write_onnx(tmp_path / "plain.onnx", "pictures"))


OTHERS = [pytest.param(name, marks=pytest.mark.long) for name in ("original", "small", "resnet18")]


@pytest.mark.parametrize("network", ["pilotnet", *OTHERS])
def test_the_crop_in_the_graph_is_that_of_training(network: str, car: Path, tmp_path: Path) -> None:
    spec: PictureSpec = built_in(network, {}).picture
    path = car / "first.onnx"
    if network != "pilotnet":
        path = tmp_path / "run.onnx"
        export_onnx(untrained_run(tmp_path / "run", network=network), path, of_camera=True)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    for size in [(160, 320), (120, 160), (480, 640), (7, 9), (1, 1)]:
        picture = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
        (crop,) = session.run(["crop"], {"picture": picture})
        expected = preprocess(np.ascontiguousarray(picture[..., ::-1]), spec)
        assert (crop.dtype, crop.shape) == (np.uint8, spec.shape)
        assert np.array_equal(crop, expected), size


def test_in_a_thread_it_gives_the_last_answer_until_it_is_shut_down(
    car: Path, pilot_class: Any, road: Any
) -> None:
    pilot = pilot_class(car / "first.onnx")
    thread = threading.Thread(target=pilot.update, daemon=True)
    assert pilot.run_threaded(road) == (0.0, 0.0)
    thread.start()
    while (answer := pilot.run_threaded(road)) == (0.0, 0.0):
        pass
    assert answer == pilot.run(road)
    pilot.shutdown()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def test_it_prints_the_next_steps_and_replaces_nothing_unasked(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["export", trained, "--donkeycar", tmp_path / "car"]
    assert call(main, *line) == 0
    printed = capsys.readouterr()
    assert "input picture: uint8 (height, width, 3), RGB, 0..255, of any size" in printed.out
    files = f"{tmp_path / 'car' / 'first.onnx'} {tmp_path / 'car' / 'donkeycar_part.py'}"
    assert printed.err.splitlines()[-1].startswith(f"next: `scp {files} pi@donkeypi.local:mycar/`")
    assert 'V.add(OnnxPilot("first.onnx"), inputs=["cam/image_array"],' in printed.err
    assert call(main, *line) == 1
    assert "first.onnx exists already" in capsys.readouterr().err
    assert call(main, *line, "--force") == 0
    (tmp_path / "car" / "donkeycar_part.py").write_text("mine")
    (tmp_path / "car" / "first.onnx").unlink()
    assert call(main, *line) == 1
    assert "donkeycar_part.py exists already" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "car").iterdir()] == ["donkeycar_part.py"]
