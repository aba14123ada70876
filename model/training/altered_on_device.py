"""The alterations of an epoch as tensor operations, for pictures on a device.

The pixels equal those of `EpochAlterations.alter`, except for rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from dataset.epoch_alterations import NOISE_LEVEL, Drawn, noise_of


class AlteredOnDevice:
    """Alters the pictures (N, height, width, 3) of an epoch on their device."""

    def __init__(self, drawn: Drawn, height: int, width: int, device: torch.device) -> None:
        def sent(values: Any) -> Tensor:
            return torch.from_numpy(np.asarray(values, np.float32)).to(device)

        self._size = height, width
        self._row, self._column = torch.arange(height, device=device)[:, None], torch.arange(width, device=device)
        self._theta = sent(_theta(drawn.matrix, height, width)) if drawn.matrix is not None else None
        self._colours = sent(drawn.colours) if drawn.colours is not None else None
        self._shade = sent(drawn.shade) if drawn.shade is not None else None
        self._strip = sent(drawn.strip[:, :, 0])
        self._box = sent(drawn.box) if drawn.box is not None else None
        self._noise = sent(drawn.noise / NOISE_LEVEL) if drawn.noise is not None else None
        if self._noise is not None:
            size = height * width * 3
            self._piece = torch.from_numpy(drawn.piece).to(device)
            self._pieces = torch.from_numpy(noise_of(size)).to(device).unfold(0, size, 1)  # a view

    def pictures(self, pictures: Tensor, start: int) -> Tensor:
        """The altered BGR pictures (N, height, width, 3) uint8; the first is the epoch's sample `start`."""
        part = slice(start, start + len(pictures))
        height, width = self._size
        altered = pictures.permute(0, 3, 1, 2).float()
        if self._theta is not None:
            grid = functional.affine_grid(self._theta[part], list(altered.shape), align_corners=False)
            altered = functional.grid_sample(altered, grid, padding_mode="border", align_corners=False)
        if self._colours is not None:
            colours = self._colours[part][:, :, :, None, None]
            # not as a product of matrices, which a GPU would round to TensorFloat-32
            shares = (colours[:, :, colour] * altered[:, colour, None] for colour in range(3))
            altered = sum(shares, start=colours[:, :, 3]).clamp(0, 255)
        if self._shade is not None:
            top_left, top_right, bottom_right, bottom_left = self._strip[part].T[:, :, None, None]
            down = self._row / max(1, height - 1)
            is_dark = self._column >= torch.lerp(top_left, bottom_left, down)
            is_dark &= self._column <= torch.lerp(top_right, bottom_right, down)
            light = torch.where(is_dark, self._shade[part, None, None], 1)
            altered = altered * light[:, None]
        if self._box is not None:
            left, top, right, bottom, level = self._box[part].T[:, :, None, None]
            is_blank = (self._column >= left) & (self._column < right)
            is_blank = is_blank & (self._row >= top) & (self._row < bottom)
            altered = torch.where(is_blank[:, None], level[:, None], altered)
        if self._noise is not None:
            noise = self._pieces[self._piece[part]].view(-1, height, width, 3).permute(0, 3, 1, 2)
            altered = altered + self._noise[part, None, None, None] * (noise.float() - 128)
        return altered.round().clamp(0, 255).to(torch.uint8).permute(0, 2, 3, 1).contiguous()


def _theta(matrix: Any, height: int, width: int) -> Any:
    """Convert matrices (N, 2, 3) in px to PyTorch's coordinates: -1 to 1 between the outer edges of the pixels."""
    to_px = np.array([[width / 2, 0, (width - 1) / 2], [0, height / 2, (height - 1) / 2], [0, 0, 1]])
    size = np.array([width, height])
    theta = (matrix @ to_px) * (2 / size)[:, None]
    theta[:, :, 2] += 1 / size - 1
    return theta
