"""The layer whose outputs are a network's answers, found by asking the network."""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor, nn

from dataset.picture_spec import PictureSpec
from model.network.picture_network import PictureNetwork

_TRIED = 2  # pictures


@torch.inference_mode()
def answer_layer(network: PictureNetwork, picture: PictureSpec) -> str | None:
    """The name of the `nn.Linear` whose outputs the network answers as they are; None where there is none.

    It is asked for by trying: with its weights and bias halved, all answers must be half as large.
    """
    tried = copy.deepcopy(network).eval()
    device = next(tried.parameters()).device
    height, width, _ = picture.shape
    levels = torch.arange(_TRIED * 3 * height * width, device=device) * 37 % 256
    pictures = levels.to(torch.uint8).reshape(_TRIED, 3, height, width)
    called: list[str] = []

    def note(name: str) -> Any:
        return lambda *_: called.append(name)

    layers = {name: layer for name, layer in tried.named_modules() if _is_plain(layer)}
    hooks = [layer.register_forward_hook(note(name)) for name, layer in layers.items()]
    before: Tensor = tried(pictures)
    for hook in hooks:
        hook.remove()
    if not called or called.count(called[-1]) > 1:
        return None
    last = layers[called[-1]]
    assert isinstance(last, nn.Linear)  # noqa: S101
    if last.out_features != 1:
        return None
    last.weight.mul_(0.5)
    last.bias.mul_(0.5)
    halved = torch.equal(tried(pictures), before * 0.5)  # halving is exact in floating point
    last.bias.add_(1.0)
    return called[-1] if halved and torch.allclose(tried(pictures), before * 0.5 + 1.0) else None


def _is_plain(layer: nn.Module) -> bool:
    """A linear layer whose own weight and bias are what it calculates with."""
    return type(layer) is nn.Linear and layer.bias is not None and not hasattr(layer, "parametrizations")
