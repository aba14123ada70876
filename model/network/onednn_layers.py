"""Convolutions, pooling and ReLU one after another, learnt in oneDNN's own tensors where that is faster.

Of a step on a processor with AMX, whose convolutions are quick, nearly half was PyTorch's max pooling: it keeps an
int64 for each maximum, and clears the whole gradient before it fills in a quarter. oneDNN keeps a byte, and writes
the gradient once, but PyTorch leaves pooling to it only in tensors of oneDNN's own kind and layout. For AMX it is
the layout of PyTorch's convolutions, too, and all results are the same to the last bit. Without AMX it is another,
in which convolutions were slower: there, and in float32, everything stays as it is.
"""

from __future__ import annotations

import os
from typing import Any

import torch
from torch import Tensor, nn


class OneDnnLayers(nn.Sequential):
    """`nn.Conv2d` that pads with zeros, `nn.MaxPool2d` and `nn.ReLU`: the same as an `nn.Sequential` of them, only
    that hooks of the convolutions are not called while it learns."""

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
