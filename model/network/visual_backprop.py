"""Attention maps of a network by VisualBackProp, after Bojarski et al. 2016 (arXiv 1611.05418).

The output of each convolution's ReLU is averaged over its channels. The map begins as the last layer's average.
From layer to layer, a deconvolution with that layer's kernel and stride, and ones as weights, enlarges the map,
which is then multiplied by the average of the layer before. The first layer enlarges it to the picture's size.

The paper's network has strides, the toolkit's original network has pooling. A deconvolution with ones undoes
pooling, too: a value goes to every pixel of its window. Pixels at an edge that pooling left out get 0.

Hooks find the layers during a pass. If the layers are not a chain (a residual network adds shortcuts), the map
is enlarged bilinearly, and multiplied by the average of the last ReLU of each size.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from model.errors import RunError
from model.network.picture_network import PictureNetwork

Side = int | tuple[int, ...]


@torch.inference_mode()
def visual_backprop(network: nn.Module, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """The output of `network` for inputs (N, channels, height, width), and attention maps (N, height, width), each
    from 0 to 1, or all 0 if the map is constant. One pass computes both.

    Raises RunError for a network without an `nn.ReLU` after a convolution.
    """
    with _Watched(network) as watched:
        outputs = network(inputs)
    if not any(step.average is not None for step in watched.steps):
        raise RunError("attention cannot be computed: the network has no nn.ReLU after a convolution")
    size = inputs.shape[2:]
    maps = _through_chain(watched.steps) if watched.is_chain else _through_sizes(watched.steps)
    if maps.shape[1:] != size:
        maps = _enlarged(maps, size)
    return outputs, _normalised(maps)


@dataclass
class _Step:
    layer: nn.Module
    size: torch.Size  # height and width of the input
    average: Tensor | None  # mean over channels of the output of a ReLU; None for other layers


@dataclass
class _Watched:
    """Records the layers of a network that output planes (N, channels, height, width), in the order of the
    pass."""

    network: nn.Module
    steps: list[_Step] = field(default_factory=list)
    is_chain: bool = True
    _last: Tensor | None = None
    _hooks: list[Any] = field(default_factory=list)

    def __enter__(self) -> _Watched:
        layers = [layer for layer in self.network.modules() if not list(layer.children())]
        self._hooks = [layer.register_forward_hook(self._called) for layer in layers]
        return self

    def __exit__(self, *exception: object) -> None:
        for hook in self._hooks:
            hook.remove()

    def _called(self, layer: nn.Module, inputs: tuple[Any, ...], outputs: Any) -> None:
        if not (isinstance(outputs, Tensor) and outputs.dim() == 4 and len(inputs) == 1):
            return
        if self._last is not None and inputs[0] is not self._last:
            self.is_chain = False
        average = outputs.mean(1) if isinstance(layer, nn.ReLU) else None  # now: a later layer may overwrite it
        self.steps.append(_Step(layer, inputs[0].shape[2:], average))
        self._last = outputs


def _through_chain(steps: list[_Step]) -> Tensor:
    averages = [step.average for step in steps if step.average is not None]
    maps = torch.ones_like(averages[-1])
    is_behind = True  # layers behind the last ReLU have no average
    for step in reversed(steps):
        if step.average is not None:
            maps, is_behind = maps * step.average, False
        elif is_behind:
            continue
        elif isinstance(step.layer, nn.Conv2d | nn.MaxPool2d) and not isinstance(step.layer.padding, str):
            maps = _spread(maps, step.size, step.layer.kernel_size, step.layer.stride, step.layer.padding)
        elif maps.shape[1:] != step.size:
            maps = _enlarged(maps, step.size)
    return maps


def _through_sizes(steps: list[_Step]) -> Tensor:
    by_size = {step.average.shape: step.average for step in steps if step.average is not None}
    maps, *larger = sorted(by_size.values(), key=lambda average: average.shape[1] * average.shape[2])
    for average in larger:
        maps = _enlarged(maps, average.shape[1:]) * average
    return maps


def _enlarged(maps: Tensor, size: torch.Size) -> Tensor:
    return functional.interpolate(maps[:, None], size=list(size), mode="bilinear", align_corners=False)[:, 0]


def _spread(maps: Tensor, size: torch.Size, kernel: Side, stride: Side, padding: Side) -> Tensor:
    """Deconvolution with ones to `size` (height, width).

    Ones are separable: a sum of shifted rows, then of shifted columns, takes a twentieth of the time of
    `conv_transpose2d`, which is slow for a single channel.
    """
    for axis, length in enumerate(size, 1):
        wide, step, edge = (
            side if isinstance(side, int) else side[axis - 1] for side in (kernel, stride, padding)
        )
        before, after = maps.shape[:axis], maps.shape[axis + 1 :]
        end = (maps.shape[axis] - 1) * step + 1
        spread = maps.new_zeros(*before, max(length + 2 * edge, end + wide - 1), *after)
        for shift in range(wide):
            places = (slice(None),) * axis + (slice(shift, shift + end, step),)
            spread[places].add_(maps)
        maps = spread.narrow(axis, edge, length)
    return maps


def _normalised(maps: Tensor) -> Tensor:
    low, high = maps.amin((1, 2), keepdim=True), maps.amax((1, 2), keepdim=True)
    span = high - low
    return torch.where((span > 0) & (span < torch.inf), (maps - low) / span, 0.0)


@torch.inference_mode()
def answers_and_features(network: PictureNetwork, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """The answers to inputs (N, channels, height, width), and features (N, D).

    The features are the input of the second fully connected layer; of the first if there is only one; the
    answers if there is none. Later layers hold little more than the steering.
    """
    layer_inputs: list[Tensor] = []

    def called(layer: nn.Module, inputs: tuple[Any, ...]) -> None:
        layer_inputs.append(inputs[0])

    layers = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    hooks = [layer.register_forward_pre_hook(called) for layer in layers]
    try:
        answers = network(inputs)
    finally:
        for hook in hooks:
            hook.remove()
    features = layer_inputs[min(1, len(layer_inputs) - 1)] if layer_inputs else answers
    return answers, features.flatten(1).float() if features.dim() > 1 else features[:, None].float()
