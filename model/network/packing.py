"""Weights laid out for the processor once, for a network that drives."""

from __future__ import annotations

import torch
from torch import Tensor, nn

# oneDNN multiplies bfloat16 weights in an order of its own. PyTorch's layers bring them into it at every call, and
# for one picture that takes a quarter of the time: 0.5 ms of 2.2. These operators are what torch.compile calls for
# frozen weights; they have no public name, and torch.compile itself needs a C++ compiler.
_ONEDNN = torch.ops.mkldnn


class PackedConvolution(nn.Module):
    """The same as an `nn.Conv2d` of bfloat16 weights with neither padding nor stride."""

    def __init__(self, layer: nn.Conv2d) -> None:
        super().__init__()
        self._weight = _ONEDNN._reorder_convolution_weight(layer.weight.detach(), [0, 0], [1, 1], [1, 1])
        self._bias = layer.bias

    def forward(self, inputs: Tensor) -> Tensor:
        """(N, channels, height, width) to the same."""
        outputs: Tensor = _ONEDNN._convolution_pointwise(
            inputs, self._weight, self._bias, [0, 0], [1, 1], [1, 1], 1, "none", [], ""
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
def pack_weights(layers: nn.Sequential) -> bool:
    """Put packed layers in the place of `layers`' own, whose weights are bfloat16; False, and nothing is changed,
    where this PyTorch or this processor has none."""
    try:
        packed = [_packed(layer) for layer in layers]
    except (AttributeError, RuntimeError):  # no such operator, or none for this processor
        return False
    for number, layer in enumerate(packed):
        layers[number] = layer
    return True


def _packed(layer: nn.Module) -> nn.Module:
    """Each is tried once: a processor may have the weights' order, and not the operator."""
    if isinstance(layer, nn.Conv2d):
        packed: nn.Module = PackedConvolution(layer)
        packed(torch.zeros(1, layer.in_channels, *layer.kernel_size, dtype=torch.bfloat16))
    elif isinstance(layer, nn.Linear):
        packed = PackedLinear(layer)
        packed(torch.zeros(1, layer.in_features, dtype=torch.bfloat16))
    else:
        packed = layer
    return packed
