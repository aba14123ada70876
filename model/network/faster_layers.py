"""Faster layers: oneDNN's own for a network that learns, packed weights and max pooling for one that drives."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn


def swap_layers(network: nn.Module, swap: Callable[[nn.Module], nn.Module | None]) -> Callable[[], None]:
    """Put the layers that `swap` returns in the place of a network's own (None: it stays); returns what undoes it.

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


# oneDNN multiplies bfloat16 weights in an order of its own. PyTorch's layers bring them into it at every call, and
# for one picture that takes a quarter of the time: 0.5 ms of 2.2. These operators are what torch.compile calls for
# frozen weights; they have no public name, and torch.compile itself needs a C++ compiler.
_ONEDNN = torch.ops.mkldnn


class PackedConvolution(nn.Module):
    """The same as an `nn.Conv2d` of bfloat16 weights that pads with zeros."""

    def __init__(self, layer: nn.Conv2d) -> None:
        super().__init__()
        self._options = (list(layer.padding), list(layer.stride), list(layer.dilation), layer.groups)
        self._weight = _ONEDNN._reorder_convolution_weight(layer.weight.detach(), *self._options)
        self._bias = layer.bias

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, channels, height, width) to the same."""
        outputs: Tensor = _ONEDNN._convolution_pointwise(
            inputs, self._weight, self._bias, *self._options, "none", [], ""
        )
        return outputs


class PackedLinear(nn.Module):
    """The same as an `nn.Linear` of bfloat16 weights."""

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
    """Put packed layers in the place of a network's own, whose weights are bfloat16; returns what undoes it. None,
    and nothing is changed, where this PyTorch or this processor has none."""
    try:
        return swap_layers(network, _packed)
    except (AttributeError, RuntimeError):  # no such operator, or none for this processor
        return None


def _packed(layer: nn.Module) -> nn.Module | None:
    """Each is tried once: a processor may have the weights' order, and not the operator."""
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
    """The same as `nn.MaxPool2d(2)`, to the last bit, for pictures in channels_last.

    PyTorch's own also finds out where each maximum was, and takes two to three times as long in bfloat16: 0.2 ms
    of the 2 ms that a picture takes.
    """

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, channels, height, width) to (N, channels, height // 2, width // 2)."""
        pixels = inputs.permute(0, 2, 3, 1)
        height, width = (side // 2 * 2 for side in pixels.shape[1:3])
        rows = torch.maximum(pixels[:, 0:height:2], pixels[:, 1:height:2])
        return torch.maximum(rows[:, :, 0:width:2], rows[:, :, 1:width:2]).permute(0, 3, 1, 2)


def sliced_max_pool(layer: nn.Module) -> nn.Module | None:
    """A `SlicedMaxPool` equal to a layer; None if the layer is not a plain 2x2 pooling."""
    if type(layer) is not nn.MaxPool2d or layer.ceil_mode or layer.return_indices:
        return None
    settings = [sides(side) for side in (layer.kernel_size, layer.stride, layer.padding, layer.dilation)]
    return SlicedMaxPool() if settings == [(2, 2), (2, 2), (0, 0), (1, 1)] else None


def sides(value: int | tuple[int, ...]) -> tuple[int, ...]:
    """Both sides of a layer's kernel, stride or the like, which may be given as one number."""
    return (value, value) if isinstance(value, int) else tuple(value)


class OneDnnLayers(nn.Sequential):
    """`nn.Conv2d` that pads with zeros, `nn.MaxPool2d` and `nn.ReLU`: the same as an `nn.Sequential` of them, only
    that hooks of the convolutions are not called while it learns; in oneDNN's own tensors where that is faster.

    Of a step on a processor with AMX, whose convolutions are quick, nearly half was PyTorch's max pooling: it
    keeps an int64 for each maximum, and clears the whole gradient before it fills in a quarter. oneDNN keeps a
    byte, and writes the gradient once, but PyTorch leaves pooling to it only in tensors of oneDNN's own kind and
    layout. For AMX it is the layout of PyTorch's convolutions, too, and all results are the same to the last bit.
    Without AMX it is another, in which convolutions were slower: there, and in float32, everything stays as it is.
    """

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, channels, height, width) to the same."""
        if not (self.training and torch.is_grad_enabled() and _is_faster(inputs)):
            outputs: Tensor = super().forward(inputs)  # type: ignore[no-untyped-call]
            return outputs
        planes = inputs.to(torch.bfloat16).to_mkldnn()
        for layer in self:
            planes = _convolved(layer, planes) if isinstance(layer, nn.Conv2d) else layer(planes)
        return planes.to_dense()


def _is_faster(inputs: Tensor) -> bool:
    return (
        inputs.device.type == "cpu"
        and torch.is_autocast_enabled("cpu")
        and torch.get_autocast_dtype("cpu") == torch.bfloat16
        and torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
        and bool(torch.cpu.get_capabilities().get("amx_bf16"))
        and "ONEDNN_MAX_CPU_ISA" not in os.environ  # may switch AMX off
    )


def _convolved(layer: nn.Conv2d, planes: Tensor) -> Tensor:
    """The convolution in bfloat16, as autocast would run it if it knew this operator."""
    options: Any = layer.padding, layer.stride, layer.dilation, layer.groups
    bias = None if layer.bias is None else layer.bias.to(torch.bfloat16)
    return torch.mkldnn_convolution(planes, layer.weight.to(torch.bfloat16), bias, *options)
