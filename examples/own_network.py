"""A network of one's own: it finds where in the width of the picture the road goes.

bc-train --name mine --network examples/own_network.py:ColumnNet --network-args planes=24
"""

from torch import Tensor, nn

from dataset.picture_spec import PictureSpec


class ColumnNet(nn.Module):
    """Three convolutions, the last one over whole columns, and one layer that steers by these."""

    PICTURE = PictureSpec(width_px=160, height_px=48, channels="YUV")

    def __init__(self, planes: int = 16, dropout: float = 0.1) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(3, planes, 5, stride=2),
            nn.ReLU(),
            nn.Conv2d(planes, planes, 5, stride=2),
            nn.ReLU(),
            nn.Conv2d(planes, 2 * planes, (9, 3), stride=2),  # all rows: 18 columns are left
            nn.ReLU(),
        )
        self.head = nn.Sequential(nn.Flatten(), nn.Dropout(dropout), nn.Linear(2 * planes * 18, 1))

    def forward(self, pictures: Tensor) -> Tensor:
        """(N, 1) for pictures (N, 3, height, width) that are scaled to -1..1."""
        answers: Tensor = self.head(self.features(pictures))
        return answers
