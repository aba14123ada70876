"""`bc-train export RUN --onnx`: one file that steers as the run does, for programs without this project."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
from safetensors.numpy import load_file, save_file
from safetensors.torch import load_file as load_tensors

from dataset import decode
from dataset.preprocessing import Image
from model import RunError, load_pilot
from model.cli import main
from model.onnx_export import export_onnx
from model.runs.run_folder import save_weights
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import PATIENCE_S, environment, road_jpeg, untrained_run
from tests.helpers.exports import export
from tests.helpers.repository import ROOT
from tests.helpers.udacity import call, encode

pytestmark = pytest.mark.usefixtures("exported_once")

OURS = ["common", "simulator", "recorder", "dataset", "model", "viz", "drive"]
HIDDEN = f"import sys; sys.modules.update(dict.fromkeys({['torch', 'onnx', *OURS]}))\n"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = untrained_run(tmp_path_factory.mktemp("runs") / "first", network="original")
    weights = load_tensors(run / "model.safetensors")
    for name, values in weights.items():
        if name.endswith(".bias"):
            values.fill_(0.01)  # else the exporter leaves them out, and a run with biases needs another export
    save_weights(run, weights, epoch=0)
    return run


@pytest.fixture(scope="module")
def exported(trained: Path) -> Path:
    path = trained.with_name("first.onnx")
    assert export_onnx(trained, path) < 1e-4
    return path


def session(path: Path) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])


def metadata(path: Path) -> dict[str, str]:
    return dict(session(path).get_modelmeta().custom_metadata_map)


def pictures(folder: Path) -> list[Path]:
    """Three pictures of the simulator's size, and one larger, from which more rows are cut."""
    encoded = [road_jpeg(number) for number in (1, 8, 20)]
    larger = encode(cv2.resize(decode(encoded[0]), (640, 480)))
    paths = [folder / f"{number}.jpg" for number in range(4)]
    for path, data in zip(paths, [*encoded, larger], strict=True):
        path.write_bytes(data)
    return paths


def as_the_pilot_steers(run_folder: Path, jpegs: list[Path]) -> list[float]:
    pilot = load_pilot(run_folder, "float32")
    return [pilot.predict(pilot.crop(decode(path.read_bytes()))) for path in jpegs]


def as_others_steer(code: str, *arguments: object) -> list[float]:
    """What a program prints that has ONNX Runtime, but neither PyTorch nor anything of this project."""
    line = [sys.executable, "-I", "-c", HIDDEN + code, *map(str, arguments)]
    done = subprocess.run(line, env=environment(), capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    return [float(number) for number in done.stdout.split()]


# What is in the file

BY_HAND = """
from fractions import Fraction
import cv2, numpy, onnxruntime
network = onnxruntime.InferenceSession(sys.argv[1], providers=["CPUExecutionProvider"])
said = network.get_modelmeta().custom_metadata_map
assert (said["preprocessing.channels"], said["preprocessing.resize"]) == ("BGR", "bilinear")
size = int(said["preprocessing.width_px"]), int(said["preprocessing.height_px"])
crops = []
for name in sys.argv[2:]:
    picture = cv2.imread(name)
    top, bottom = (round(len(picture) * Fraction(said["preprocessing.crop_" + end])) for end in ("top", "bottom"))
    crops.append(cv2.resize(picture[top : len(picture) - bottom], size, interpolation=cv2.INTER_LINEAR))
print(*network.run(["steering"], {"pictures": numpy.stack(crops)})[0])
"""


def test_it_steers_as_the_pilot_does_where_nothing_else_is_installed(
    trained: Path, exported: Path, tmp_path: Path
) -> None:
    jpegs = pictures(tmp_path)
    expected = as_the_pilot_steers(trained, jpegs)
    assert np.std(expected) > 1e-2  # the pictures differ, and so must their steering
    assert as_others_steer(BY_HAND, exported, *jpegs) == pytest.approx(expected, abs=1e-5)


def test_the_example_in_its_metadata_runs_as_it_is(trained: Path, exported: Path, tmp_path: Path) -> None:
    larger = pictures(tmp_path)[-1]
    expected = as_the_pilot_steers(trained, [larger])
    assert as_others_steer(metadata(exported)["example"], exported, larger) == pytest.approx(expected, abs=1e-5)


def test_pictures_go_in_as_opencv_has_them_and_one_steering_comes_out(exported: Path) -> None:
    (taken,) = session(exported).get_inputs()
    (given,) = session(exported).get_outputs()
    assert (taken.name, taken.type, taken.shape) == ("pictures", "tensor(uint8)", ["N", 128, 128, 3])
    assert (given.name, given.type, given.shape) == ("steering", "tensor(float)", ["N"])
    (operators,) = onnx.load(exported).opset_import
    assert (operators.domain, operators.version) == ("", 18)


def test_steering_is_not_clamped(trained: Path, tmp_path: Path) -> None:
    turning = with_weights(trained, tmp_path / "turning", lambda weights: weights["head.11.bias"].fill(3))
    crop: Image = np.zeros((1, 128, 128, 3), np.uint8)
    export_onnx(turning, tmp_path / "turning.onnx")
    (steering,) = session(tmp_path / "turning.onnx").run(["steering"], {"pictures": crop})[0]
    assert steering == pytest.approx(load_pilot(turning, "float32").predict(crop[0]), abs=1e-5)
    assert steering > 1


def test_it_reports_which_run_it_is(trained: Path, exported: Path) -> None:
    stored = metadata(exported)
    assert stored["run"] == "first"
    assert stored["weights_sha256"] == hashlib.sha256((trained / "model.safetensors").read_bytes()).hexdigest()
    assert stored["steering.degrees_per_unit"] == "25"
    assert stored["toolkit"].startswith("behavioural-cloning-toolkit ")


def test_the_same_run_gives_the_same_bytes_wherever_it_lies(
    trained: Path, exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("model.onnx_export._exported", export)
    moved = shutil.copytree(trained, tmp_path / "elsewhere" / "first")
    export_onnx(moved, tmp_path / "other name.onnx")
    data = exported.read_bytes()
    assert (tmp_path / "other name.onnx").read_bytes() == data
    assert str(trained.parent).encode() not in data
    assert str(Path(onnx.__file__).parent).encode() not in data
    assert str(ROOT).encode() not in data


# The command


def test_without_a_name_the_file_lies_in_the_run_and_the_python_runs_it(
    trained: Path, exported: Path, cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(trained, cwd / "runs" / "first")
    assert call(main, "export", "--onnx", "first") == 0  # the flag may stand before the run
    printed = capsys.readouterr()
    written, taken = printed.out.splitlines()
    assert written.startswith(f"{Path('runs') / 'first' / 'first.onnx'}: written; ")
    assert float(written.rpartition("largest difference ")[2]) < 1e-4
    assert taken == "input pictures: uint8 (N, 128, 128, 3), BGR, 0..255, cropped and resized"
    assert (copy / "first.onnx").read_bytes() == exported.read_bytes()
    picture = pictures(cwd)[-1]
    heading, *code, step = printed.err.splitlines()
    assert step.startswith("next: `python -m pip install onnxruntime opencv-python-headless`")
    shown = textwrap.dedent("\n".join(code)).replace("picture.jpg", picture.as_posix())
    shown = shown.replace("runs/first/first.onnx", (copy / "first.onnx").as_posix())
    assert heading == "to run it with only onnxruntime and opencv-python-headless:"
    assert as_others_steer(shown) == pytest.approx(as_the_pilot_steers(trained, [picture]), abs=1e-5)


OTHERS = [pytest.param(name, marks=pytest.mark.long) for name in ("pilotnet", "small", "resnet18")]


@pytest.mark.parametrize("network", ["original", *OTHERS])
def test_the_docs_and_the_file_give_each_networks_input(network: str, exported: Path, tmp_path: Path) -> None:
    path = exported
    if network != "original":
        path = tmp_path / "run.onnx"
        export_onnx(untrained_run(tmp_path / "run", network=network), path)
    (taken,) = session(path).get_inputs()
    _, height, width, _ = taken.shape
    shape, colours = f"(N, {height}, {width}, 3)", metadata(path)["preprocessing.channels"]
    expected = f"pictures: uint8 {shape}, {colours}, 0..255, cropped and resized"
    assert metadata(path)["input"] == expected
    assert f"| `{network}` | {shape} {colours} |" in (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")


def test_a_file_is_replaced_only_if_that_is_asked_for(
    trained: Path, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.onnx"
    mine.write_text("mine")
    line = ["export", "first", "--runs", trained.parent, "--onnx", mine]
    assert call(main, *line) == 1
    assert "mine.onnx exists already: choose another name, or give --force" in capsys.readouterr().err
    assert mine.read_text() == "mine"
    assert call(main, *line, "--force") == 0
    assert mine.read_bytes() == exported.read_bytes()


# Runs that cannot be exported

Weights = dict[str, "np.typing.NDArray[np.float32]"]


def with_weights(run_folder: Path, copy: Path, change: Callable[[Weights], object]) -> Path:
    """A copy of a run whose weights are changed."""
    shutil.copytree(run_folder, copy)
    weights = load_file(copy / "model.safetensors")
    change(weights)
    save_file(weights, copy / "model.safetensors")
    return copy


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda weights: weights["features.0.weight"].fill(np.nan), r"ONNX Runtime and PyTorch differs by nan"),
        (lambda weights: weights["head.11.weight"].fill(1e6), r"differs by .*, expected less than 0\.0001"),
        (lambda weights: weights.pop("head.11.bias"), r"model\.safetensors: weights of another network"),
    ],
    ids=["no numbers", "huge", "missing"],
)
def test_what_does_not_steer_as_the_run_does_gets_no_name(
    trained: Path, tmp_path: Path, change: Callable[[Weights], object], error: str
) -> None:
    broken = with_weights(trained, tmp_path / "broken", change)
    with pytest.raises(RunError, match=error):
        export_onnx(broken, tmp_path / "new" / "broken.onnx")
    assert list(tmp_path.iterdir()) == [broken]


def test_without_its_packages_the_error_reports_how_to_get_them(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(RunError, match=r"`pip install .*\[onnx\].*`"):
        export_onnx(trained, tmp_path / "first.onnx")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_what_was_there(trained: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.onnx"
    mine.write_text("mine")
    message = r"mine\.onnx: cannot be written \(File too large\); make room"
    with files_of_at_most(1_000_000), pytest.raises(RunError, match=message):
        export_onnx(trained, mine, overwrite=True)
    assert list(tmp_path.iterdir()) == [mine]
    assert mine.read_text() == "mine"
