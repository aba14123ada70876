"""Weights laid out for the processor once, for a network that drives."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from model.network.layer_swap import swap_layers

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
