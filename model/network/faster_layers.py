"""Faster layers: wider convolutions or oneDNN's tensors for training; packed weights and faster max pooling for
driving."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional


def swap_layers(network: nn.Module, swap: Callable[[nn.Module], nn.Module | None]) -> Callable[[], None]:
    """Replace each layer of a network by the one that `swap` returns for it; None keeps the layer. Returns a
    function that undoes it.

    If `swap` raises, nothing is changed.
    """
    swaps = [
        (parent, name, layer, new)
        for parent in network.modules()
        for name, layer in parent.named_children()
        if (new := swap(layer)) is not None
    ]
    for parent, name, _, new in swaps:
        setattr(parent, name, new)

    def undo() -> None:
        for parent, name, layer, _ in swaps:
            setattr(parent, name, layer)

    return undo


# oneDNN needs bfloat16 weights in its own memory layout. PyTorch's layers convert them at every call: for one
# picture, that takes a quarter of the time, 0.5 of 2.2 ms. torch.compile calls these operators for frozen weights.
# They have no public name, and torch.compile itself needs a C++ compiler.
_ONEDNN = torch.ops.mkldnn


class PackedConvolution(nn.Module):
    """Equal to an `nn.Conv2d` with bfloat16 weights and zero padding."""

    def __init__(self, layer: nn.Conv2d) -> None:
        super().__init__()
        self._options = (list(layer.padding), list(layer.stride), list(layer.dilation), layer.groups)
        self._weight = _ONEDNN._reorder_convolution_weight(layer.weight.detach(), *self._options)
        self._bias = layer.bias

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, channels, height, width) to a tensor of the same axes."""
        outputs: Tensor = _ONEDNN._convolution_pointwise(
            inputs, self._weight, self._bias, *self._options, "none", [], ""
        )
        return outputs


class PackedLinear(nn.Module):
    """Equal to an `nn.Linear` with bfloat16 weights."""

    def __init__(self, layer: nn.Linear) -> None:
        super().__init__()
        self._weight = _ONEDNN._reorder_linear_weight(layer.weight.detach(), batch_size=1)
        self._bias = layer.bias

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, inputs) to (N, outputs)."""
        outputs: Tensor = _ONEDNN._linear_pointwise(inputs, self._weight, self._bias, "none", [], "")
        return outputs


@torch.inference_mode()
def pack_weights(network: nn.Module) -> Callable[[], None] | None:
    """Replace a network's layers, whose weights are bfloat16, by packed ones. Returns a function that undoes it,
    or None, with nothing changed, if this PyTorch or processor does not support them."""
    try:
        return swap_layers(network, _packed)
    except (AttributeError, RuntimeError):  # the operator is missing, or does not support this processor
        return None


def _packed(layer: nn.Module) -> nn.Module | None:
    """The packed layer, or None. It is called once: a processor may support the layout but not the operator."""
    if type(layer) is nn.Conv2d and isinstance(layer.padding, tuple) and layer.padding_mode == "zeros":
        packed: nn.Module = PackedConvolution(layer)
        sides = [(side - 1) * step + 1 for side, step in zip(layer.kernel_size, layer.dilation, strict=True)]
        packed(torch.zeros(1, layer.in_channels, *sides, dtype=torch.bfloat16))
    elif type(layer) is nn.Linear:
        packed = PackedLinear(layer)
        packed(torch.zeros(1, layer.in_features, dtype=torch.bfloat16))
    else:
        return None
    return packed


class SlicedMaxPool(nn.Module):
    """Equal to `nn.MaxPool2d(2)`, to the last bit, for pictures in channels_last.

    PyTorch's layer also computes the index of each maximum, and takes two to three times as long in bfloat16: 0.2
    of 2 ms for a picture.
    """

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, channels, height, width) to (N, channels, height // 2, width // 2)."""
        pixels = inputs.permute(0, 2, 3, 1)
        height, width = (side // 2 * 2 for side in pixels.shape[1:3])
        rows = torch.maximum(pixels[:, 0:height:2], pixels[:, 1:height:2])
        return torch.maximum(rows[:, :, 0:width:2], rows[:, :, 1:width:2]).permute(0, 3, 1, 2)


def sliced_max_pool(layer: nn.Module) -> nn.Module | None:
    """A `SlicedMaxPool` equal to `layer`; None if the layer is not a plain 2x2 max pooling."""
    if type(layer) is not nn.MaxPool2d or layer.ceil_mode or layer.return_indices:
        return None
    settings = [sides(side) for side in (layer.kernel_size, layer.stride, layer.padding, layer.dilation)]
    return SlicedMaxPool() if settings == [(2, 2), (2, 2), (0, 0), (1, 1)] else None


def sides(value: int | tuple[int, ...]) -> tuple[int, ...]:
    """A layer's kernel size, stride, padding or dilation as a tuple, if it may be one number."""
    return (value, value) if isinstance(value, int) else tuple(value)


class FasterLayers(nn.Sequential):
    """An `nn.Sequential` of `nn.Conv2d` with an odd, square kernel, stride 1 and no padding, `nn.MaxPool2d(2)` and
    `nn.ReLU`. Training uses other operators where they are faster, and then does not call hooks of the
    convolutions.

    On a GPU of NVIDIA, `pooled_convolution` replaces a convolution and its pooling. Other GPUs were not tried.

    With AMX, convolutions are fast, and PyTorch's max pooling took nearly half of a step. For each maximum,
    PyTorch keeps an int64, oneDNN a byte. PyTorch clears the whole gradient before it fills in a quarter; oneDNN
    writes the gradient once. PyTorch uses oneDNN's pooling only for tensors of oneDNN's own type and layout. With
    AMX, this is also the layout of PyTorch's convolutions, and all results are equal to the last bit. Without AMX,
    and in float32, oneDNN's tensors are not used: there the layout differs, and convolutions were slower.
    """

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, channels, height, width) to a tensor of the same axes."""
        if self.training and torch.is_grad_enabled():
            if inputs.is_cuda and torch.version.hip is None:
                return self.with_wider_convolutions(inputs)
            if _is_faster_in_onednn(inputs):
                return self._in_onednn(inputs)
        outputs: Tensor = super().forward(inputs)  # type: ignore[no-untyped-call]
        return outputs

    def with_wider_convolutions(self, inputs: Tensor) -> Tensor:
        """Equal to the layers, except for rounding; for a GPU."""
        layers = deque(self)
        while layers:
            layer = layers.popleft()
            if isinstance(layer, nn.Conv2d) and layers and isinstance(layers[0], nn.MaxPool2d):
                layers.popleft()
                inputs = pooled_convolution(layer, inputs)
            else:
                inputs = layer(inputs)
        return inputs

    def _in_onednn(self, inputs: Tensor) -> Tensor:
        planes = inputs.to(torch.bfloat16).to_mkldnn()
        for layer in self:
            planes = _convolved(layer, planes) if isinstance(layer, nn.Conv2d) else layer(planes)
        return planes.to_dense()


def pooled_convolution(layer: nn.Conv2d, inputs: Tensor) -> Tensor:
    """Equal to `layer`, then `nn.MaxPool2d(2)`, except for rounding: (N, channels, height, width) to a tensor of
    the same axes. The layer has an odd, square kernel, stride 1 and no padding. If the values of a maximum are
    equal, the last gets the gradient, not the first.

    A GPU calculates a convolution as a product of matrices, and 3 or 24 channels waste most of it. So each 2 x 2
    pixels become one pixel of 4 times the channels, and the four values of each maximum become four outputs, from
    kernels in four places. There are 1.44 times the multiplications of a 5 x 5 kernel, but an H200 trains in half
    the time. PyTorch's max pooling is also slower than its maximum over an axis.
    """
    channels, side = layer.in_channels, layer.kernel_size[0]
    height, width = ((size - side + 1) // 2 for size in inputs.shape[2:])
    blocks = side // 2 + 1  # that a kernel touches
    kind = inputs.device.type
    dtype = torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else inputs.dtype
    pixels = inputs.to(dtype).permute(0, 2, 3, 1)
    pixels = pixels[:, : 2 * height + side - 1, : 2 * width + side - 1]
    shape = len(pixels), height + blocks - 1, 2, width + blocks - 1, 2, channels
    pixels = pixels.reshape(shape).transpose(2, 3).flatten(3)
    # (outputs, channels, down, right, row, column): moved down and right by 1 or 0 pixels
    kernels = functional.pad(layer.weight.to(pixels.dtype), (1, 1, 1, 1))
    kernels = kernels.unfold(2, side + 1, 1).unfold(3, side + 1, 1)
    kernels = kernels.reshape(-1, channels, 2, 2, blocks, 2, blocks, 2).permute(2, 3, 0, 4, 6, 5, 7, 1)
    kernels = kernels.reshape(-1, blocks, blocks, 4 * channels).permute(0, 3, 1, 2)
    outputs = functional.conv2d(pixels.permute(0, 3, 1, 2), kernels).permute(0, 2, 3, 1)
    pooled = outputs.reshape(len(outputs), height, width, 4, layer.out_channels).max(3).values
    if layer.bias is not None:
        pooled = pooled + layer.bias.to(pooled.dtype)
    return pooled.permute(0, 3, 1, 2)


def _is_faster_in_onednn(inputs: Tensor) -> bool:
    return (
        inputs.device.type == "cpu"
        and torch.is_autocast_enabled("cpu")
        and torch.get_autocast_dtype("cpu") == torch.bfloat16
        and torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
        and bool(torch.cpu.get_capabilities().get("amx_bf16"))
        and "ONEDNN_MAX_CPU_ISA" not in os.environ  # it may disable AMX
    )


def _convolved(layer: nn.Conv2d, planes: Tensor) -> Tensor:
    """The convolution in bfloat16, as autocast would run it if it supported this operator."""
    options: Any = layer.padding, layer.stride, layer.dilation, layer.groups
    bias = None if layer.bias is None else layer.bias.to(torch.bfloat16)
    return torch.mkldnn_convolution(planes, layer.weight.to(torch.bfloat16), bias, *options)
