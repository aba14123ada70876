"""What a network makes of pictures before it answers: alike pictures have alike features."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from model.network.picture_network import PictureNetwork


@torch.inference_mode()
def answers_and_features(network: PictureNetwork, inputs: Tensor) -> tuple[Tensor, Tensor]:
    """The answers to inputs (N, channels, height, width), and features (N, D): what goes into the second
    fully connected layer or, of one, into that. The later layers know little but the steering. Of a network
    without any: the answers."""
    given: list[Tensor] = []

    def called(layer: nn.Module, inputs: tuple[Any, ...]) -> None:
        given.append(inputs[0])

    layers = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    hooks = [layer.register_forward_pre_hook(called) for layer in layers]
    try:
        answers = network(inputs)
    finally:
        for hook in hooks:
            hook.remove()
    features = given[min(1, len(given) - 1)] if given else answers
    return answers, features.flatten(1).float() if features.dim() > 1 else features[:, None].float()
