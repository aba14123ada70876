"""The alterations of an epoch as tensor operations, for pictures on a device.

The pixels equal those of `EpochAlterations.alter`, except for rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from dataset.epoch_alterations import NOISE_LEVEL, Drawn, Floats, noise_of


class AlteredOnDevice:
    """Alters the pictures (N, height, width, 3) of an epoch on their device."""

    def __init__(self, drawn: Drawn, height: int, width: int, device: torch.device) -> None:
        def sent(values: Any) -> Tensor:
            return torch.from_numpy(np.asarray(values, np.float32)).to(device)

        self._size = height, width
        self._row, self._column = torch.arange(height, device=device)[:, None], torch.arange(width, device=device)
        self._places = sent(_places(drawn.matrix, height, width)) if drawn.matrix is not None else None
        self._colours = sent(drawn.colours) if drawn.colours is not None else None
        self._shade = sent(drawn.shade) if drawn.shade is not None else None
        self._strip = sent(drawn.strip[:, :, 0])
        self._box = sent(drawn.box) if drawn.box is not None else None
        self._noise = sent(drawn.noise / NOISE_LEVEL) if drawn.noise is not None else None
        if self._noise is not None:
            size = height * width * 3
            self._piece = torch.from_numpy(drawn.piece).to(device)
            self._pieces = (sent(noise_of(size)) - 128).unfold(0, size, 1)  # a view

    def pictures(self, pictures: Tensor, start: int) -> Tensor:
        """The altered BGR pictures (N, height, width, 3) uint8; the first is the epoch's sample `start`."""
        part = slice(start, start + len(pictures))
        height, width = self._size
        altered = pictures.permute(0, 3, 1, 2).float()
        if self._places is not None:
            right, down, shift = self._places[part, None, None].unbind(4)
            grid = right * self._column[:, None] + (down * self._row[:, :, None] + shift)
            altered = functional.grid_sample(altered, grid, padding_mode="border", align_corners=False)
        if self._colours is not None:
            colours = self._colours[part][:, :, :, None, None]
            mixed = colours[:, :, 3]
            for colour in range(3):
                mixed = torch.addcmul(mixed, colours[:, :, colour], altered[:, colour, None])
            altered = mixed.clamp_(0, 255)
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
            altered = torch.addcmul(altered, self._noise[part, None, None, None], noise)
        altered = altered.round_().clamp_(0, 255).permute(0, 2, 3, 1)
        return altered.to(torch.uint8, memory_format=torch.contiguous_format)


def _places(matrix: Floats, height: int, width: int) -> Floats:
    """The matrices (N, 2, 3), with their results in PyTorch's coordinates: -1 to 1 between the outer edges of the
    pixels."""
    size = np.array([width, height])
    places = matrix * (2 / size)[:, None]
    places[:, :, 2] += 1 / size - 1
    return places
