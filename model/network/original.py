"""The network of the original project: 5,022,327 parameters from a picture to a steering angle.

After Bojarski et al. 2016, "End to End Learning for Self-Driving Cars" (arXiv 1604.07316), with max pooling in
place of strides, a larger input, and dropout.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import torch
from torch import Tensor, nn

PARAMETERS: Final = 5_022_327


class SteeringNetwork(nn.Module):
    """BGR pictures (N, 3, 128, 128), uint8 or float 0..255, to steering (N,): -1 left .. 1 right, unclamped."""

    natural: Callable[[Tensor], Tensor] | None = None
    """From what was learnt to the network's answer; None while it learns, and where both are the same."""

    def __init__(self, dropout: float = 0.5) -> None:
        super().__init__()

        def convolution(inputs: int, outputs: int, kernel: int, *, pool: bool) -> list[nn.Module]:
            # Pooling comes before ReLU: the maximum of ReLUs is the ReLU of the maximum, at a quarter of the work.
            pooling: list[nn.Module] = [nn.MaxPool2d(2)] if pool else []
            return [nn.Conv2d(inputs, outputs, kernel), *pooling, nn.ReLU()]

        self.features = nn.Sequential(
            *convolution(3, 24, 5, pool=True),  # 128 -> 124 -> 62
            *convolution(24, 36, 5, pool=True),  # 62 -> 58 -> 29
            *convolution(36, 48, 5, pool=True),  # 29 -> 25 -> 12
            *convolution(48, 64, 3, pool=False),  # 12 -> 10
            *convolution(64, 64, 3, pool=False),  # 10 -> 8
        )
        self.head = nn.Sequential(
            nn.Flatten(),  # 64 x 8 x 8 = 4096
            nn.Dropout(dropout),
            nn.Linear(4096, 1164),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(1164, 100),
            nn.ReLU(),
            nn.Linear(100, 50),
            nn.ReLU(),
            nn.Linear(50, 10),
            nn.ReLU(),
            nn.Linear(10, 1),
        )
        for layer in self.modules():
            # Glorot and Bengio 2010, as in Keras, which the original used. With PyTorch's own, smaller weights
            # the network answers nearly the same to every picture for the whole first epoch.
            if isinstance(layer, nn.Conv2d | nn.Linear):
                nn.init.xavier_uniform_(layer.weight)
                nn.init.zeros_(layer.bias)  # type: ignore[arg-type]

    def forward(self, pictures: Tensor) -> Tensor:
        return self.steering(self.features(scaled(pictures)))

    def steering(self, features: Tensor) -> Tensor:
        """The answer (N,) by what `features` gives, (N, 64, 8, 8)."""
        learnt: Tensor = self.head(features).squeeze(1)
        return learnt if self.natural is None else self.natural(learnt.float())


def scaled(pictures: Tensor) -> Tensor:
    """Pictures, uint8 or float 0..255, as float32 -1..1."""
    return pictures.to(torch.float32) / 127.5 - 1.0
