"""Inner features of a network: similar pictures have similar features."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from model.network.picture_network import PictureNetwork


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
