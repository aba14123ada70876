"""The alterations of `dataset.augment`, on whole batches and on any device: the same draws, and the same pictures
to within a level.

What each sample gets is drawn once: its seed stands in the index, and never changes.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from dataset.augment import ALTERATIONS, Blur, Brightness, Shadow, draw
from dataset.index.samples_file import Rows
from dataset.preprocess import SIZE_PX

MASK_BYTES: Final = SIZE_PX * SIZE_PX // 8

# What a step of an alteration is; any other number is a blur with a kernel of so many pixels.
_NOTHING, _BRIGHTNESS, _SHADOW = 0, 1, 2


@dataclass(frozen=True)
class _Step:
    """One alteration of some samples of an epoch, on the device."""

    what: int
    place: Tensor  # (M,) where in their batch they are
    sample: Tensor  # (M,) which they are
    cuts: list[int]  # those of batch b are cuts[b] to cuts[b + 1] of the two


class Alterations:
    """What each of some samples gets, kept on a device."""

    def __init__(self, rows: Rows, device: torch.device) -> None:
        """Draws everything, 0.1 ms a sample. Raises DatasetError for an alteration that no index of ours has."""
        names = np.array(rows.alterations, object)[rows.alteration]
        self._what = np.full((len(ALTERATIONS), len(rows)), _NOTHING, np.int8)  # of each sample, one after another
        brightness, light = (np.ones(len(rows), np.float32) for _ in range(2))
        mask_of = np.zeros(len(rows), np.int64)
        masks: list[NDArray[np.uint8]] = []
        for sample in np.flatnonzero(names != "").tolist():
            for step, drawn in enumerate(draw(names[sample], int(rows.seed[sample]), SIZE_PX, SIZE_PX)):
                match drawn:
                    case Blur(kernel_px):
                        self._what[step, sample] = kernel_px
                    case Brightness(factor):
                        self._what[step, sample] = _BRIGHTNESS
                        brightness[sample] = factor
                    case Shadow(mask, factor):
                        self._what[step, sample] = _SHADOW
                        light[sample] = factor
                        mask_of[sample] = len(masks)
                        masks.append(np.packbits(mask > 0, axis=1))
        packed = np.stack(masks) if masks else np.zeros((0, SIZE_PX, SIZE_PX // 8), np.uint8)
        self._device = device
        self._brightness, self._light, self._mask_of, self._masks = (
            torch.from_numpy(array).to(device) for array in (brightness, light, mask_of, packed)
        )

    def steps(self, parts: list[NDArray[np.int64]]) -> list[_Step]:
        """What is to be done to batches of these samples: sent to the device at once, so that no batch waits."""
        samples = np.concatenate([*parts, np.zeros(0, np.int64)])
        places = np.concatenate([*map(np.arange, map(len, parts)), np.zeros(0, np.int64)])
        starts = np.cumsum([0, *map(len, parts)])
        found = []
        for whats in self._what:
            of_samples = whats[samples]
            for what in np.unique(of_samples[of_samples != _NOTHING]).tolist():
                at = np.flatnonzero(of_samples == what)
                place, sample = (torch.from_numpy(array[at]).to(self._device) for array in (places, samples))
                found.append(_Step(what, place, sample, np.searchsorted(at, starts).tolist()))
        return found

    def apply(self, steps: list[_Step], batch: int, pictures: Tensor) -> None:
        """Alter the pictures (N, 128, 128, 3) of the batch with this number, BGR uint8, in place."""
        for step in steps:
            part = slice(step.cuts[batch], step.cuts[batch + 1])
            if part.start == part.stop:
                continue
            place, sample = step.place[part], step.sample[part]
            chosen = pictures.index_select(0, place)
            if step.what == _BRIGHTNESS:
                changed = brightened(chosen, self._brightness.index_select(0, sample))
            elif step.what == _SHADOW:
                mask = _unpacked(self._masks.index_select(0, self._mask_of.index_select(0, sample)))
                changed = shaded(chosen, mask, self._light.index_select(0, sample))
            else:
                changed = blurred(chosen, step.what)
            pictures.index_copy_(0, place, changed)


def blurred(pictures: Tensor, kernel_px: int) -> Tensor:
    """Pictures (N, H, W, 3) uint8 with the Gaussian blur of OpenCV, which counts in 65536ths of a level: these
    integers, and their sums, are exact in float32."""
    weights = [256 * float(weight) for weight in cv2.getGaussianKernel(kernel_px, 0)[:, 0]]
    height, width = pictures.shape[1:3]
    around = kernel_px // 2
    planes = functional.pad(pictures.permute(0, 3, 1, 2).float(), (around,) * 4, mode="reflect")
    rows = _sum([weight * planes[:, :, :, i : i + width] for i, weight in enumerate(weights)])
    total = _sum([weight * rows[:, :, i : i + height] for i, weight in enumerate(weights)])
    return torch.floor((total + 32768) / 65536).to(torch.uint8).permute(0, 2, 3, 1)


def brightened(pictures: Tensor, factor: Tensor) -> Tensor:
    """Pictures (N, H, W, 3) BGR uint8, their HSV value times `factor` (N,); hue and saturation in OpenCV's steps:
    180 and 256 of them."""
    blue, green, red = pictures.to(torch.int32).unbind(3)
    value = torch.maximum(torch.maximum(blue, green), red)
    span = value - torch.minimum(torch.minimum(blue, green), red)
    per_value, per_span = _divisions(pictures.device)
    saturation = (span * per_value[value] + 2048) >> 12
    sixth = torch.where(
        value == red,
        green - blue,
        torch.where(value == green, blue - red + 2 * span, red - green + 4 * span),
    )
    hue = ((sixth * per_span[span] + 2048) >> 12) % 180
    scaled = (value * factor[:, None, None]).round().clamp(max=255)
    # B, G and R as one formula: https://en.wikipedia.org/wiki/HSL_and_HSV#HSV_to_RGB_alternative
    channels = []
    for number in (1, 3, 5):
        k = (number + hue / 30) % 6
        channels.append(scaled * (1 - saturation / 255 * torch.minimum(k, 4 - k).clamp(0, 1)))
    return torch.stack(channels, 3).to(torch.uint8)  # cuts off the fraction, as OpenCV does here


def shaded(pictures: Tensor, mask: Tensor, factor: Tensor) -> Tensor:
    """Pictures (N, H, W, 3) uint8, times `factor` (N,) where `mask` (N, H, W) is true."""
    darker = (pictures * factor[:, None, None, None]).round().to(torch.uint8)
    return torch.where(mask[:, :, :, None], darker, pictures)


def _unpacked(masks: Tensor) -> Tensor:
    """Bits (N, H, W / 8), as `numpy.packbits` packs them, to truth values (N, H, W)."""
    bit = 1 << torch.arange(7, -1, -1, device=masks.device)
    return (masks[:, :, :, None] & bit.to(torch.uint8)).ne(0).flatten(2)


def _sum(parts: list[Tensor]) -> Tensor:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


@functools.cache
def _divisions(device: torch.device) -> tuple[Tensor, Tensor]:
    """OpenCV's tables (256,) that stand for division by the value and by the span, in 4096ths; by 0 it gives 0."""
    by = np.maximum(np.arange(256), 1)
    tables = (np.rint((scale << 12) / by).astype(np.int32) for scale in (255, 30))
    per_value, per_span = (torch.from_numpy(np.where(np.arange(256) > 0, table, 0)) for table in tables)
    return per_value.to(device), per_span.to(device)
