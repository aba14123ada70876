"""The network of the original project: from a picture to steering with 5,022,327 parameters.

After Bojarski et al. 2016, "End to End Learning for Self-Driving Cars" (arXiv 1604.07316), with max pooling
instead of strides, a larger input, and dropout.
"""

from __future__ import annotations

from typing import Final

from torch import nn

from model.network.faster_layers import FasterLayers
from model.network.picture_network import LayerChain, glorot_weights

PARAMETERS: Final = 5_022_327


class SteeringNetwork(LayerChain):
    """BGR pictures (N, 3, 128, 128), uint8 or float 0..255, to steering (N,): -1 left .. 1 right, unclamped;
    or to targets (N, outputs)."""

    def __init__(self, dropout: float = 0.5, outputs: int = 1, standardized: bool = False) -> None:
        super().__init__(standardized)

        def convolution(inputs: int, outputs: int, kernel: int, *, pool: bool) -> list[nn.Module]:
            # Pooling before ReLU gives the same result as after it, for a quarter of the ReLUs.
            pooling: list[nn.Module] = [nn.MaxPool2d(2)] if pool else []
            return [nn.Conv2d(inputs, outputs, kernel), *pooling, nn.ReLU()]

        self.features = FasterLayers(
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
            nn.Linear(10, outputs),
        )
        glorot_weights(self)
