"""A small network for small computers, for example a Raspberry Pi: 81,929 parameters.

It needs 3.6 million multiplications a picture; the original network needs 137 million. Like PilotNet, it has
strided convolutions instead of pooling.
"""

from __future__ import annotations

from torch import nn

from dataset.picture_spec import PictureSpec
from model.network.picture_network import LayerChain, glorot_weights


class SmallNetwork(LayerChain):
    """BGR pictures (N, 3, 48, 96) to steering (N,), or (N, outputs)."""

    PICTURE = PictureSpec(width_px=96, height_px=48)

    def __init__(self, outputs: int = 1, standardized: bool = False) -> None:
        super().__init__(standardized)
        self.features = nn.Sequential(
            *(nn.Conv2d(3, 16, 5, stride=2), nn.ReLU()),  # 48 x 96 -> 22 x 46
            *(nn.Conv2d(16, 24, 5, stride=2), nn.ReLU()),  # -> 9 x 21
            *(nn.Conv2d(24, 32, 3, stride=2), nn.ReLU()),  # -> 4 x 10
            *(nn.Conv2d(32, 48, 3), nn.ReLU()),  # -> 2 x 8
        )
        self.head = nn.Sequential(
            nn.Flatten(),
            *(nn.Linear(48 * 2 * 8, 64), nn.ReLU()),
            *(nn.Linear(64, 16), nn.ReLU()),
            nn.Linear(16, outputs),
        )
        glorot_weights(self)
