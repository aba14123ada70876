"""Attention maps of a network by VisualBackProp, after Bojarski et al. 2016 (arXiv 1611.05418).

What each convolution layer gives after its ReLU is averaged over its channels. From the last layer to the first,
the map is brought to the size of the layer before by a deconvolution whose weights are all one, of the layer's own
kernel and stride, and multiplied by that layer's average; the first layer's brings it to the size of the picture.

The paper's network has strides where this one pools. Pooling is a part of the layer, and is undone before its
convolution, as a deconvolution with ones of its kernel and stride: a value goes to every place that it may be the
maximum of. What pooling has left out at an edge gets nothing.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from model.network.original import SteeringNetwork, scaled

Side = int | tuple[int, ...]


@torch.inference_mode()
def predict_with_attention(network: SteeringNetwork, pictures: Tensor) -> tuple[Tensor, Tensor]:
    """The network's steering (N,) for pictures (N, 3, 128, 128), the same as of calling it, and where it looks:
    (N, 128, 128) float32, 0 nowhere .. 1 most of that picture. One pass through the network gives both."""
    found, maps = visual_backprop(network.features, scaled(pictures))
    return network.steering(found), maps


@torch.inference_mode()
def visual_backprop(layers: nn.Sequential, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """The output of `layers` (convolutions without padding, pooling, ReLU) for inputs (N, channels, height,
    width), and attention maps (N, height, width), each from 0 to 1, or all 0 where nothing stands out."""
    averages: list[Tensor] = []
    passed: list[tuple[nn.Module, torch.Size]] = []  # the layers, and the height and width of what went in
    outputs = inputs
    for layer in layers:
        passed.append((layer, outputs.shape[2:]))
        outputs = layer(outputs)
        if isinstance(layer, nn.ReLU):
            averages.append(outputs.mean(1))
    maps = torch.ones_like(averages[-1])
    for layer, size in reversed(passed):
        if isinstance(layer, nn.ReLU):
            maps = maps * averages.pop()
        elif isinstance(layer, nn.Conv2d | nn.MaxPool2d):
            maps = _spread(maps, size, layer.kernel_size, layer.stride)
    return outputs, _normalised(maps)


def _spread(maps: Tensor, size: torch.Size, kernel: Side, stride: Side) -> Tensor:
    """Deconvolution by ones, without padding, to `size` (height, width).

    Ones are separable: a sum of shifted rows, then of shifted columns, takes a twentieth of the time of
    `conv_transpose2d`, which is slow for a single channel.
    """
    for axis, length in enumerate(size, 1):
        wide, step = (side if isinstance(side, int) else side[axis - 1] for side in (kernel, stride))
        before, after = maps.shape[:axis], maps.shape[axis + 1 :]
        spread = maps.new_zeros(*before, length, *after)
        end = (maps.shape[axis] - 1) * step + 1
        for shift in range(wide):
            places = (slice(None),) * axis + (slice(shift, shift + end, step),)
            spread[places].add_(maps)
        maps = spread
    return maps


def _normalised(maps: Tensor) -> Tensor:
    low, high = maps.amin((1, 2), keepdim=True), maps.amax((1, 2), keepdim=True)
    span = high - low
    return torch.where((span > 0) & (span < torch.inf), (maps - low) / span, 0.0)
