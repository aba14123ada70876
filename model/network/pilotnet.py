"""Networks of convolutions after Bojarski et al. 2016, "End to End Learning for Self-Driving Cars" (arXiv
1604.07316): the original project's, PilotNet as printed, and a small one.
"""

from __future__ import annotations

from typing import Final

from torch import nn

from dataset.picture_spec import PictureSpec
from model.network.faster_layers import FasterLayers
from model.network.picture_network import LayerChain, glorot_weights

PARAMETERS: Final = 5_022_327


class SteeringNetwork(LayerChain):
    """The network of the original project: as PilotNet, but with max pooling instead of strides, a larger input,
    and dropout.

    BGR pictures (N, 3, 128, 128), uint8 or float 0..255, to steering (N,): -1 left .. 1 right, unclamped;
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


class PilotNet(LayerChain):
    """The network of the paper's figure 4, as printed; 252,219 parameters.

    Strided convolutions, no pooling, no dropout. The figure has 1164 flattened values, but 64 planes of 1 x 18 are
    1152, which gives the 250 thousand parameters and 27 million connections of the text. The paper states neither
    activations nor initial weights: they are those of the original project's network.

    YUV pictures (N, 3, 66, 200) to steering (N,), or (N, outputs)."""

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


class SmallNetwork(LayerChain):
    """A network for small computers, for example a Raspberry Pi: 81,929 parameters.

    It needs 3.6 million multiplications a picture; the original network needs 137 million. Like PilotNet, it has
    strided convolutions instead of pooling.

    BGR pictures (N, 3, 48, 96) to steering (N,), or (N, outputs)."""

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
