"""PilotNet: the network of Bojarski et al. 2016 (arXiv 1604.07316), figure 4, as printed; 252,219 parameters.

Strided convolutions, no pooling, no dropout. The figure has 1164 flattened values, but 64 planes of 1 x 18 are
1152, which gives the 250 thousand parameters and 27 million connections of the text. The paper states neither
activations nor initial weights: they are those of the original project's network.
"""

from __future__ import annotations

from torch import nn

from dataset.picture_spec import PictureSpec
from model.network.picture_network import LayerChain, glorot_weights


class PilotNet(LayerChain):
    """YUV pictures (N, 3, 66, 200) to steering (N,), or (N, outputs)."""

    PICTURE = PictureSpec(width_px=200, height_px=66, channels="YUV")

    def __init__(self, outputs: int = 1, standardized: bool = False) -> None:
        super().__init__(standardized)
        self.features = nn.Sequential(
            *(nn.Conv2d(3, 24, 5, stride=2), nn.ReLU()),  # 66 x 200 -> 31 x 98
            *(nn.Conv2d(24, 36, 5, stride=2), nn.ReLU()),  # -> 14 x 47
            *(nn.Conv2d(36, 48, 5, stride=2), nn.ReLU()),  # -> 5 x 22
            *(nn.Conv2d(48, 64, 3), nn.ReLU()),  # -> 3 x 20
            *(nn.Conv2d(64, 64, 3), nn.ReLU()),  # -> 1 x 18
        )
        self.head = nn.Sequential(
            nn.Flatten(),
            *(nn.Linear(64 * 1 * 18, 100), nn.ReLU()),
            *(nn.Linear(100, 50), nn.ReLU()),
            *(nn.Linear(50, 10), nn.ReLU()),
            nn.Linear(10, outputs),
        )
        glorot_weights(self)
