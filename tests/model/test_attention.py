"""Where a network looks: VisualBackProp as it is written down in the paper, in plain loops, says the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import nn

from dataset import decode, preprocess
from model.evaluation.predict import as_input
from model.network.pilotnet import SteeringNetwork
from model.network.visual_backprop import visual_backprop
from model.runs.run_folder import load_network
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.rrd import contents, view_names
from tests.helpers.udacity import call
from viz.cli import main
from viz.playback.predicted_recording import overlay

Values = NDArray[np.float64]


def convolved(inputs: Values, layer: nn.Conv2d) -> Values:
    """A convolution, then ReLU, in loops."""
    weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()  # type: ignore[union-attr]
    (_, _, high, wide), stride = weight.shape, layer.stride[0]
    rows, columns = (inputs.shape[1] - high) // stride + 1, (inputs.shape[2] - wide) // stride + 1
    result = np.zeros((len(weight), rows, columns))
    for channel in range(len(weight)):
        for i in range(rows):
            for j in range(columns):
                seen = inputs[:, i * stride : i * stride + high, j * stride : j * stride + wide]
                result[channel, i, j] = max(0.0, (seen * weight[channel]).sum() + bias[channel])
    return result


def pooled(inputs: Values) -> Values:
    return np.array(
        [
            [[part[i : i + 2, j : j + 2].max() for j in range(0, part.shape[1] - 1, 2)]
             for i in range(0, part.shape[0] - 1, 2)]
            for part in inputs
        ]
    )  # fmt: skip


def spread(small: Values, size: tuple[int, int], kernel: int, stride: int) -> Values:
    """Deconvolution: each value is added to every place that it was made of."""
    result = np.zeros(size)
    for i in range(small.shape[0]):
        for j in range(small.shape[1]):
            result[i * stride : i * stride + kernel, j * stride : j * stride + kernel] += small[i, j]
    return result


def test_the_map_is_that_of_the_paper() -> None:
    """Two convolutions, the first pooled (and a row and a column left out), the second with a stride."""
    torch.manual_seed(3)
    first, second = nn.Conv2d(3, 4, 3), nn.Conv2d(4, 5, 3, stride=2)
    inputs = torch.randn(2, 3, 17, 21)
    _, maps = visual_backprop(nn.Sequential(first, nn.MaxPool2d(2), nn.ReLU(), second, nn.ReLU()), inputs)
    for picture, shown in zip(inputs.numpy().astype(np.float64), maps.numpy(), strict=True):
        convolved_once = convolved(picture, first)  # 15 x 19: one row and one column too many to pool
        after_first = pooled(convolved_once)
        after_second = convolved(after_first, second)
        relevance = spread(after_second.mean(axis=0), (7, 9), kernel=3, stride=2) * after_first.mean(axis=0)
        relevance = spread(spread(relevance, (15, 19), kernel=2, stride=2), (17, 21), kernel=3, stride=1)
        expected = (relevance - relevance.min()) / (relevance.max() - relevance.min())
        np.testing.assert_allclose(shown, expected, atol=1e-5)


def crops(numbers: list[int]) -> NDArray[np.uint8]:
    return np.stack([preprocess(decode(road_jpeg(number))) for number in numbers])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "some run", network="original")


def test_the_steering_is_the_networks_and_each_picture_has_its_map(run: Path) -> None:
    network = load_network(run)
    pictures = as_input(crops([1, 5, 9]))
    steering, maps = visual_backprop(network, pictures)
    with torch.inference_mode():
        assert torch.equal(steering, network(pictures))
    assert maps.shape == (3, 128, 128)
    assert maps.amin((1, 2)).tolist() == [0.0] * 3
    assert maps.amax((1, 2)).tolist() == [1.0] * 3
    for number in range(3):
        _, alone = visual_backprop(network, pictures[number : number + 1])
        torch.testing.assert_close(alone[0], maps[number], atol=1e-4, rtol=0)


def test_it_looks_where_there_is_something_to_see() -> None:
    """A network that sees bright things: a white post on black is all that it looks at."""
    network = SteeringNetwork().eval()
    with torch.no_grad():
        for layer in network.features:
            if isinstance(layer, nn.Conv2d):
                layer.weight.fill_(1 / layer.weight[0].numel())
    picture = np.zeros((1, 128, 128, 3), np.uint8)
    picture[:, :, 80:90] = 255
    _, maps = visual_backprop(network, as_input(picture))
    columns = maps[0].sum(0)
    assert 80 <= int(columns.argmax()) < 90
    assert columns[:50].max() == columns[120:].max() == 0


def test_the_overlay_is_the_crop_with_a_colour_where_it_looks() -> None:
    crop = np.full((1, 128, 128, 3), 100, np.uint8)
    maps = np.zeros((1, 128, 128), np.float32)
    maps[0, 40] = 1.0
    (picture,) = overlay(crop, maps)
    assert (picture[:40] == 80).all()
    blue, green, red = picture[40, 0].tolist()
    assert min(blue, red) > green + 100


def test_the_viewer_gets_it_as_jpegs_at_the_times_of_the_frames(tmp_path: Path, run: Path) -> None:
    rows = 70  # more than a batch
    log = write_log(tmp_path / "a.mcap", [0.0] * rows, lambda camera, row: road_jpeg(row), cameras=["center"])
    assert call(main, log, "--run", run, "--attention", "--save", tmp_path / "a.rrd") == 0
    assert "where some run looks" in view_names(tmp_path / "a.rrd")
    chunk = contents(tmp_path / "a.rrd")["/attention/some\\ run"]
    assert chunk["message_log_time"] == [START_NS + row * STEP_NS for row in range(rows)]
    assert chunk["EncodedImage:media_type"] == [["image/jpeg"]] * rows
    jpegs = [bytes(blob[0]) for blob in chunk["EncodedImage:blob"]]
    assert max(map(len, jpegs)) < 15_000
    for row in (0, 69):
        shown = decode(jpegs[row])
        _, maps = visual_backprop(load_network(run), as_input(crops([row])))
        off = np.abs(shown.astype(np.float64) - overlay(crops([row]), maps.numpy())[0])
        assert shown.shape == (128, 128, 3)
        assert off.mean() < 4  # what a JPEG loses
