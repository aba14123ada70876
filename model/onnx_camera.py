"""A run's network as PyTorch modules for an ONNX file: from crops, or from a camera's picture of any size.

The arithmetic is OpenCV's, with weights of 11 bits for the resize and of 14 bits for YUV, so the crop equals that
of `dataset.preprocessing.preprocess`. Doubles hold all integers of this arithmetic exactly.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from dataset.picture_spec import ROWS, PictureSpec
from dataset.prediction_targets import TARGETS, TargetName
from model.network.picture_network import PictureNetwork


class FromCrops(nn.Module):
    """Crops, uint8 (N, height, width, 3), to the steering and other targets in their units, each float32 (N,)."""

    def __init__(self, network: PictureNetwork, targets: Sequence[TargetName]) -> None:
        super().__init__()
        self.network, self.targets = network, tuple(targets)

    def forward(self, pictures: Tensor) -> tuple[Tensor, ...]:
        answers = self.network(pictures.permute(0, 3, 1, 2))
        if len(self.targets) == 1:
            return (answers,)
        others = (answers[:, at] * TARGETS[name].per_unit for at, name in enumerate(self.targets[1:], 1))
        return (answers[:, 0], *others)


class FromCamera(FromCrops):
    """One picture, uint8 RGB (height, width, 3), to the outputs of `FromCrops` and the crop."""

    def __init__(self, network: PictureNetwork, targets: Sequence[TargetName], spec: PictureSpec) -> None:
        super().__init__(network, targets)
        self.spec = spec

    def forward(self, picture: Tensor) -> tuple[Tensor, ...]:
        crop = _in_channels(_resized(picture, self.spec), self.spec.channels).to(torch.uint8)
        return (*super().forward(crop.unsqueeze(0)), crop)


def _resized(picture: Tensor, spec: PictureSpec) -> Tensor:
    """The rows of `PictureSpec.crop_slice` in the network's size, equal to cv2.resize with INTER_LINEAR."""
    height, width = (torch.scalar_tensor(side, dtype=torch.float64) for side in picture.shape[:2])
    top = torch.minimum(torch.round(height * (spec.crop_top / ROWS)), height - 1)
    rows = torch.maximum(height - torch.round(height * (spec.crop_bottom / ROWS)) - top, torch.ones_like(top))
    left, right, share = _neighbours(width, spec.width_px)
    share = share[:, None]
    levels = picture.double()
    levels = ((levels[:, left] * (2048 - share) + levels[:, right] * share) / 16).floor()
    above, below, share = _neighbours(rows, spec.height_px)
    above, below, share = above + top.long(), below + top.long(), share[:, None, None]
    upper, lower = levels[above] * (2048 - share), levels[below] * share
    return (((upper / 65536).floor() + (lower / 65536).floor() + 2) / 4).floor()


def _neighbours(length: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """For each of `size` positions on an axis: the two nearest pixels, and the share of the second in 1/2048."""
    position = ((torch.arange(size, dtype=torch.float64) + 0.5) * (length / size) - 0.5).float()
    first, last = position.floor(), (length - 1).float()
    pixels = (torch.minimum(first.clamp(min=0), last).long(), torch.minimum(first + 1, last).long())
    return *pixels, ((position - first) * 2048).round().double()


def _in_channels(rgb: Tensor, channels: str) -> Tensor:
    """The picture in the order of colours `channels`, equal to cv2.cvtColor."""
    if channels == "RGB":
        return rgb
    red, green, blue = rgb.unbind(2)
    if channels == "BGR":
        return torch.stack([blue, green, red], dim=2)
    luma = ((red * 4899 + green * 9617 + blue * 1868 + 8192) / 16384).floor()
    from_blue, from_red = ((blue - luma) * 8061, (red - luma) * 14369)
    chroma = (((part + 8192) / 16384).floor() + 128 for part in (from_blue, from_red))
    return torch.stack([luma, *chroma], dim=2).clamp(0, 255)
