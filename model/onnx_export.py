"""Export a run's network as one ONNX file, for programs without this toolkit and PyTorch; also for a DonkeyCar.

PyTorch's exporter writes the graph. The file gets its name after ONNX Runtime was compared with PyTorch.

The graph begins with crops, or with a camera's picture of any size. Its arithmetic is OpenCV's, with weights of 11
bits for the resize and of 14 bits for YUV, so the crop equals that of `dataset.preprocessing.preprocess`. Doubles
hold all integers of this arithmetic exactly.

ONNX, ONNX Script and ONNX Runtime are an extra (`pip install ".[onnx]"`). Only this file imports them.
"""

from __future__ import annotations

import importlib
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.export import Dim

from common import atomic_file
from common.errors import printable
from common.files import refuse_existing
from common.named_function import in_one_line
from common.versions import TOOLKIT, install_line, version_of
from dataset.picture_spec import ROWS, PictureSpec, metadata_of
from dataset.prediction_targets import STEERING_ONLY, TARGETS, TargetName
from dataset.preprocessing import as_bgr, preprocess
from model.errors import RunError
from model.evaluation.predict import as_input
from model.network.picture_network import PictureNetwork
from model.runs.car_of_run import known_max_steering_deg_of_run
from model.runs.run_files import run_write_errors
from model.runs.run_folder import load_network, picture_of_run, run_name, targets_of_run, weights_checksum

if TYPE_CHECKING:
    from onnx import ModelProto


class FromCrops(nn.Module):
    """Crops, uint8 (N, height, width, 3), to the steering and other targets in their units, each float32 (N,)."""

    def __init__(self, network: PictureNetwork, targets: Sequence[TargetName]) -> None:
        super().__init__()
        self.network, self.targets = network, tuple(targets)

    def forward(self, pictures: Tensor) -> tuple[Tensor, ...]:
        answers = self.network(pictures.permute(0, 3, 1, 2))
        if len(self.targets) == 1:
            return (answers,)
        others = (answers[:, at] * TARGETS[name].per_unit for at, name in enumerate(self.targets[1:], 1))
        return (answers[:, 0], *others)


class FromCamera(FromCrops):
    """One picture, uint8 RGB (height, width, 3), to the outputs of `FromCrops` and the crop."""

    def __init__(self, network: PictureNetwork, targets: Sequence[TargetName], spec: PictureSpec) -> None:
        super().__init__(network, targets)
        self.spec = spec

    def forward(self, picture: Tensor) -> tuple[Tensor, ...]:
        crop = _in_channels(_resized(picture, self.spec), self.spec.channels).to(torch.uint8)
        return (*super().forward(crop.unsqueeze(0)), crop)


def _resized(picture: Tensor, spec: PictureSpec) -> Tensor:
    """The rows of `PictureSpec.crop_slice` in the network's size, equal to cv2.resize with INTER_LINEAR."""
    height, width = (torch.scalar_tensor(side, dtype=torch.float64) for side in picture.shape[:2])
    top = torch.minimum(torch.round(height * (spec.crop_top / ROWS)), height - 1)
    rows = torch.maximum(height - torch.round(height * (spec.crop_bottom / ROWS)) - top, torch.ones_like(top))
    left, right, share = _neighbours(width, spec.width_px)
    share = share[:, None]
    levels = picture.double()
    levels = ((levels[:, left] * (2048 - share) + levels[:, right] * share) / 16).floor()
    above, below, share = _neighbours(rows, spec.height_px)
    above, below, share = above + top.long(), below + top.long(), share[:, None, None]
    upper, lower = levels[above] * (2048 - share), levels[below] * share
    return (((upper / 65536).floor() + (lower / 65536).floor() + 2) / 4).floor()


def _neighbours(length: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """For each of `size` positions on an axis: the two nearest pixels, and the share of the second in 1/2048."""
    position = ((torch.arange(size, dtype=torch.float64) + 0.5) * (length / size) - 0.5).float()
    first, last = position.floor(), (length - 1).float()
    pixels = (torch.minimum(first.clamp(min=0), last).long(), torch.minimum(first + 1, last).long())
    return *pixels, ((position - first) * 2048).round().double()


def _in_channels(rgb: Tensor, channels: str) -> Tensor:
    """The picture in the order of colours `channels`, equal to cv2.cvtColor."""
    if channels == "RGB":
        return rgb
    red, green, blue = rgb.unbind(2)
    if channels == "BGR":
        return torch.stack([blue, green, red], dim=2)
    luma = ((red * 4899 + green * 9617 + blue * 1868 + 8192) / 16384).floor()
    from_blue, from_red = ((blue - luma) * 8061, (red - luma) * 14369)
    chroma = (((part + 8192) / 16384).floor() + 128 for part in (from_blue, from_red))
    return torch.stack([luma, *chroma], dim=2).clamp(0, 255)


OPSET, IR_VERSION = 18, 8  # ONNX 1.13 (2022), the earliest that PyTorch writes
_ABOUT: Final = {
    "speed": "the speed in mph that the car should have a little later, not clamped",
    "throttle": "-1 (full brake) .. 1 (full throttle), not clamped",
}
_CAMERA_PX: Final = ((320, 160), (160, 120), (640, 480), (128, 128), (97, 61), (224, 224), (40, 30), (320, 240))
"""Widths and heights of the pictures that test a file with preprocessing."""
MAX_DIFFERENCE: Final = 1e-4  # of steering -1..1: 0.0025 degrees; rounding in float32 gives about 1e-6
MAX_CROP_DIFFERENCE: Final = 1  # level of 255; 0 with OpenCV 5 on x86


def export_onnx(run: Path | str, path: Path | str, *, of_camera: bool = False, overwrite: bool = False) -> float:
    """Write the network of a run folder to `path`. Returns the largest difference of its steering between ONNX
    Runtime and PyTorch on a few pictures.

    Input: "pictures", uint8 (N, height, width, 3), in the network's order of colours. Outputs: "steering", float32
    (N,), not clamped, -1 (left) .. 1 (right); "speed_mph" and "throttle" for these targets. With `of_camera`, the
    file contains the preprocessing: its input is one "picture", uint8 RGB (height, width, 3) of any size, N is 1,
    and "crop" is a further output. The file's metadata describe its use. Equal runs give equal bytes.

    Raises RunError if the run is incomplete, damaged or of another version, if its network cannot be written or
    its steering differs, if ONNX, ONNX Script or ONNX Runtime is missing, or if the disk is full. Raises UserError
    if `path` exists.
    """
    require_onnx()
    run, path = Path(run), Path(path)
    refuse_existing(path, overwrite)
    picture, network = picture_of_run(run), load_network(run)
    targets = targets_of_run(run)
    model = _model(run, network, picture, targets, of_camera)
    with run_write_errors(path), atomic_file(path, overwrite=overwrite) as part:
        part.write_bytes(model.SerializeToString())
        compare = _largest_difference_of_camera if of_camera else _largest_difference
        difference = compare(part, network, picture, targets)
        if not difference < MAX_DIFFERENCE:  # also NaN
            raise RunError(
                f"{path}: not written: the steering of ONNX Runtime and PyTorch differs by {difference:.1g},"
                f" expected less than {MAX_DIFFERENCE:g}; its weights are huge or not finite: train it again"
            )
    return difference


def require_onnx() -> None:
    """Raise RunError if ONNX, ONNX Script or ONNX Runtime is not installed."""
    try:
        for name in ("onnx", "onnxruntime", "onnxscript"):
            importlib.import_module(name)
    except ImportError as error:
        raise RunError(
            f"exporting needs ONNX, ONNX Script and ONNX Runtime ({error}): install them with"
            f" `{install_line('onnx')}`"
        ) from None


def example(spec: PictureSpec, network: str, picture: str) -> str:
    """Python code that prints the steering for a picture, without this toolkit and PyTorch. `network` and
    `picture` are Python expressions of the paths of the ONNX file and the picture."""
    top, bottom = spec.description["crop_top"], spec.description["crop_bottom"]
    convert = "" if spec.channels == "BGR" else f"crop = cv2.cvtColor(crop, cv2.COLOR_BGR2{spec.channels})\n"
    return (
        "import cv2, onnxruntime\n"
        f'network = onnxruntime.InferenceSession({network}, providers=["CPUExecutionProvider"])\n'
        f"picture = cv2.imread({picture})\n"
        f"rows = picture[round(len(picture) * {top}) : len(picture) - round(len(picture) * {bottom})]\n"
        f"crop = cv2.resize(rows, ({spec.width_px}, {spec.height_px}))\n{convert}"
        '(steering,) = network.run(["steering"], {"pictures": crop[None]})[0]\n'
        "print(steering)\n"
    )


def description(
    run: Path, picture: PictureSpec, targets: Sequence[TargetName] = STEERING_ONLY, of_camera: bool = False
) -> dict[str, str]:
    """The metadata of the file: its input, its outputs, and its run."""
    top, bottom = picture.description["crop_top"], picture.description["crop_bottom"]
    size = f"{picture.width_px}x{picture.height_px}"
    colours = "" if picture.channels == "BGR" else f" Then from BGR to {picture.channels} (cv2.cvtColor)."
    preprocessing = (
        f"A camera picture as BGR, uint8, (height, width, 3). Cut round(height * {top}) rows off its top and"
        f" round(height * {bottom}) off its bottom. Resize to {size}, bilinear (OpenCV's"
        f" INTER_LINEAR).{colours} Nothing else: the network scales the levels itself."
    )
    code = "import sys\n" + example(picture, "sys.argv[1]", "sys.argv[2]")
    return {
        "input": input_line(picture, of_camera),
        "preprocessing": "In the graph." if of_camera else preprocessing,
        **metadata_of(picture),
        **_steering(known_max_steering_deg_of_run(run)),
        **{TARGETS[name].answer_name: _ABOUT[name] for name in targets[1:]},
        **({} if of_camera else {"example": code}),
        "run": printable(run_name(run)),
        "weights_sha256": weights_checksum(run),
        "toolkit": f"{TOOLKIT} {version_of()}",
    }


def input_line(picture: PictureSpec, of_camera: bool = False) -> str:
    """The size, the order of colours and the range of a file's input, in one line."""
    if of_camera:
        return "picture: uint8 (height, width, 3), RGB, 0..255, of any size, as the camera gives it"
    height, width, _ = picture.shape
    return f"pictures: uint8 (N, {height}, {width}, 3), {picture.channels}, 0..255, cropped and resized"


def _steering(max_deg: float | None) -> dict[str, str]:
    if max_deg is None:
        return {"steering": "-1 (left) .. 1 (right), not clamped; 1 is full lock, an unknown angle"}
    return {
        "steering": f"-1 (left) .. 1 (right), not clamped; 1 is {max_deg:g} degrees",
        "steering.degrees_per_unit": f"{max_deg:g}",
    }


def _model(
    run: Path, network: PictureNetwork, picture: PictureSpec, targets: Sequence[TargetName], of_camera: bool
) -> ModelProto:
    from onnx import checker, helper

    try:
        model = _exported(network, picture, targets, of_camera)
    except RunError as error:
        raise RunError(f"{run}: its network cannot be written as ONNX: {error}") from None
    model.producer_name, model.producer_version, model.ir_version = TOOLKIT, version_of(), IR_VERSION
    helper.set_model_props(model, description(run, picture, targets, of_camera))
    checker.check_model(model, full_check=True)
    return model


def _exported(
    network: PictureNetwork, picture: PictureSpec, targets: Sequence[TargetName], of_camera: bool
) -> ModelProto:
    """PyTorch's export, without paths on this machine. Raises RunError for a network that PyTorch cannot
    export."""
    from onnx_ir.passes.common import ClearMetadataAndDocStringPass
    from torch.onnx import OnnxExporterError

    names = [TARGETS[name].answer_name for name in targets]
    if of_camera:
        module: nn.Module = FromCamera(network, targets, picture)
        inputs, outputs, sample = "picture", [*names, "crop"], torch.zeros(160, 320, 3, dtype=torch.uint8)
        sizes = ({0: Dim("height"), 1: Dim("width")},)
    else:
        module = FromCrops(network, targets)
        inputs, outputs, sample = "pictures", names, torch.zeros(2, *picture.shape, dtype=torch.uint8)
        sizes = ({0: Dim("N")},)
    with warnings.catch_warnings(), torch.no_grad(), _without_log():
        warnings.simplefilter("ignore")
        try:
            traced = torch.export.export(module.eval(), (sample,), dynamic_shapes=sizes)
        except Exception as error:  # the network's own code reads values of the picture
            raise RunError(f"its path through the layers depends on the picture ({in_one_line(error)})") from None
        try:
            program = torch.onnx.export(
                traced,
                dynamic_shapes=sizes,
                input_names=[inputs],
                output_names=outputs,
                opset_version=OPSET,
                verbose=False,
            )
        except OnnxExporterError as error:
            raise RunError(f"ONNX lacks a part of it ({in_one_line(_cause(error))})") from None
    assert program is not None  # noqa: S101  # None only if a file is given
    ClearMetadataAndDocStringPass()(program.model)
    model = program.model_proto
    model.graph.ClearField("value_info")
    for value in (*model.graph.input, *model.graph.output):
        value.ClearField("metadata_props")
    return model


@torch.inference_mode()
def _largest_difference(
    path: Path, network: PictureNetwork, picture: PictureSpec, targets: Sequence[TargetName]
) -> float:
    """The largest difference between the file in ONNX Runtime and the network in PyTorch, on a batch of one
    picture and a batch of seven."""
    session = _session(path)
    pictures = _pictures(picture)
    batches = [pictures[:1], pictures[1:]]
    names = [TARGETS[name].answer_name for name in targets]
    exported = np.concatenate([np.stack(session.run(names, {"pictures": batch}), axis=1) for batch in batches])
    expected = np.concatenate([network(as_input(batch)).numpy() for batch in batches])
    return _difference(exported, expected, targets)


@torch.inference_mode()
def _largest_difference_of_camera(
    path: Path, network: PictureNetwork, picture: PictureSpec, targets: Sequence[TargetName]
) -> float:
    """As `_largest_difference`, on the crops that the file makes. Raises RunError if they differ from the crops of
    training."""
    session = _session(path)
    names = [TARGETS[name].answer_name for name in targets]
    differences = []
    for size, crop in zip(_CAMERA_PX, _pictures(picture), strict=True):
        bgr = cv2.resize(as_bgr(crop, picture), size).astype(np.uint8, copy=False)
        *answers, seen = session.run([*names, "crop"], {"picture": np.ascontiguousarray(bgr[..., ::-1])})
        off = int(np.abs(seen.astype(np.int16) - preprocess(bgr, picture)).max())
        if off > MAX_CROP_DIFFERENCE:
            raise RunError(f"{path}: not written: its crop differs from training's by {off} grey levels")
        expected = network(as_input(seen[None])).numpy()
        differences.append(_difference(np.stack(answers, axis=1), expected, targets))
    return float(np.max(differences))  # NaN if one is NaN


@contextmanager
def _without_log() -> Iterator[None]:
    """Disable logging: if the export fails, PyTorch logs whole graphs to stderr."""
    before = logging.root.manager.disable
    logging.disable()
    try:
        yield
    finally:
        logging.disable(before)


def _cause(error: BaseException) -> BaseException:
    return error if error.__cause__ is None else _cause(error.__cause__)


def _session(path: Path) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # a thread pool warns on stderr if it may not choose its cores
    return onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])


def _difference(
    exported: NDArray[np.float32], expected: NDArray[np.float32], targets: Sequence[TargetName]
) -> float:
    """The largest difference between answers `exported` (N, K), in the units of the targets, and answers
    `expected`, in the units of the labels."""
    learnt = exported / [1.0 if name == "steering" else TARGETS[name].per_unit for name in targets]
    with np.errstate(invalid="ignore"):  # NaN in the weights: the difference is NaN
        return float(np.abs(learnt - expected.reshape(learnt.shape)).max())


def _pictures(picture: PictureSpec) -> NDArray[np.uint8]:
    """Eight fixed pictures (8, height, width, 3): noise, black, white, and roads that bend from left to right."""
    random = np.random.default_rng(0)
    height, width, _ = picture.shape
    rows, columns = np.mgrid[0 : 1 : height * 1j, 0 : 1 : width * 1j]
    pictures = np.zeros((8, height, width, 3))
    pictures[0] = random.integers(0, 256, pictures[0].shape)
    pictures[2] = 255
    for road, bend in zip(pictures[3:], np.linspace(-0.5, 0.5, 5), strict=True):
        is_road = np.abs(columns - 0.5 - bend * (1 - rows) ** 2) < 0.05 + 0.4 * rows
        road[:] = np.where(is_road[..., None], (90, 90, 90), (70, 140, 60)) + random.normal(0, 8, road.shape)
    return pictures.clip(0, 255).astype(np.uint8)


PART: Final = Path(__file__).with_name("donkeycar_part.py")


def export_to_donkeycar(run: Path, folder: Path, *, overwrite: bool = False) -> tuple[Path, float]:
    """Write NAME.onnx and donkeycar_part.py to `folder`, which may exist. Returns the path of the ONNX file, and
    the largest difference of the steering between ONNX Runtime and PyTorch.

    An equal donkeycar_part.py stays. Raises RunError as `export_onnx` does; UserError if the ONNX file or a
    different donkeycar_part.py exists and `overwrite` is off.
    """
    code, part = PART.read_bytes(), folder / PART.name
    is_current = part.is_file() and part.read_bytes() == code
    if not is_current:
        refuse_existing(part, overwrite)
    path = folder / f"{run_name(run)}.onnx"
    difference = export_onnx(run, path, of_camera=True, overwrite=overwrite)
    if not is_current:
        with run_write_errors(part), atomic_file(part, overwrite=overwrite) as temporary:
            temporary.write_bytes(code)
    return path, difference
