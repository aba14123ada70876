"""Random alterations of pictures, so that a network does not memorize pixels.

The copies that fill a steering bin are altered as the index says. With `--alter-each-epoch`, every picture is
altered, differently in every epoch. These random values are a pure function of (seed, epoch, sample): a resumed
training gets the same pictures, with any number of threads and any batch size. The values of an alteration do not
depend on the other alterations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dataset.config import EpochAlteration
from dataset.errors import DatasetError
from dataset.preprocessing import Image

STEERING_A_WIDTH: Final = 4.8
"""Change of the steering, in side corrections, for a picture that is moved by its width. By default, 0.0075 for
one of 128 columns."""

NOISE_LEVEL: Final = 32.0
"""Standard deviation of the noise of `noise_of`. A share of this noise is added to a picture."""

_MOVE: Final = 8 / 128, 5 / 128  # maximum shares of width and height, in both directions
_ZOOM: Final = 0.1
_TURN_RAD: Final = np.deg2rad(3.0)
_CONTRAST: Final = 0.3
_BRIGHTNESS: Final = 30.0  # levels
_MIDDLE: Final = 127.5
_COLOUR: Final = 0.15  # share of each channel
_SHADE: Final = 0.45, 0.75  # share of the brightness in a shadow
_BOX: Final = 0.1, 0.4  # share of width and height
_NOISE: Final = 8.0  # maximum standard deviation, levels
_MIXED: Final = 0.5  # share of the pictures whose colours are mixed
_MIN_LIGHT: Final = 0.2  # of mixed grey, before it is scaled to its old contrast
_PIECES: Final = 1 << 16  # number of pieces of the noise

_DRAWS: Final[dict[EpochAlteration, slice]] = {
    "move": slice(0, 2),
    "zoom": slice(2, 3),
    "turn": slice(3, 4),
    "contrast": slice(4, 5),
    "brightness": slice(5, 6),
    "colours": slice(6, 9),
    "shadow": slice(9, 15),
    "box": slice(15, 21),
    "noise": slice(21, 23),
}
_MAX_DRAWS: Final = 24  # random values for a sample
_MIX_DRAWS: Final = slice(0, 11)
_MIX_STREAM: Final = 1
"""The mixed colours have a stream of random values of their own: they came in a later version."""

Numbers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Drawn:
    """The random alterations of N pictures. None: this alteration is not used."""

    matrix: Floats | None  # (N, 2, 3): from a pixel of the new picture to its place in the old picture, px
    colours: Floats | None  # (N, 3, 4): from (blue, green, red, 1) to the new colours
    shade: Floats | None  # (N,): share of the brightness in the shadow; 1: no shadow
    strip: NDArray[np.int32]  # (N, 4, 2): the corners of the shadow, px
    box: NDArray[np.int64] | None  # (N, 5): left, top, right, bottom in px, and the level; left = right: no box
    noise: Floats | None  # (N,): standard deviation, levels
    piece: Numbers  # (N,): the piece of the noise


@dataclass(frozen=True)
class EpochAlterations:
    names: Sequence[EpochAlteration]
    seed: int
    side_correction: float

    def labels(self, labels: NDArray[np.float32], epoch: int, samples: Numbers) -> NDArray[np.float32]:
        """The labels (N,) or (N, K) of the altered pictures: for a moved picture, the steering leads back to the
        place where it was recorded."""
        if "move" not in self.names:
            return labels
        moved = labels.copy()
        steering = moved if moved.ndim == 1 else moved[:, 0]
        share = _MOVE[0] * self._draws(epoch, samples, _DRAWS["move"])[:, 0]
        steering += (self.side_correction * STEERING_A_WIDTH * share).astype(np.float32)
        np.clip(steering, -1, 1, out=steering)
        return moved

    def alter(self, epoch: int, pictures: Image, samples: Numbers) -> None:
        """Alter the pictures (N, height, width, 3) BGR of `samples` (N,) in place."""
        drawn = self.draw(epoch, samples, pictures.shape[1], pictures.shape[2])
        for number, picture in enumerate(pictures):
            _alter(picture, drawn, number)

    def draw(self, epoch: int, samples: Numbers, height: int, width: int) -> Drawn:
        """Draw the alterations for the pictures of `samples` (N,), which have this size in px."""
        draws = self._draws(epoch, samples, slice(0, _MAX_DRAWS))
        by_name = {name: draws[:, part] for name, part in _DRAWS.items() if name in self.names}
        if "mix" in self.names:
            by_name["mix"] = self._draws(epoch, samples, _MIX_DRAWS, _MIX_STREAM)
        shade, strip = None, np.zeros((len(samples), 4, 2), np.int32)
        if (shadow := by_name.get("shadow")) is not None:
            shade = np.where(shadow[:, 0] < 0, 1, _between(_SHADE, shadow[:, 1]))
            columns = (0.5 + 0.75 * shadow[:, 2:]) * width
            strip[:, :2, 0] = np.sort(columns[:, :2])
            strip[:, :1:-1, 0] = np.sort(columns[:, 2:])
            strip[:, 2:, 1] = height - 1
        box = None
        if (drawn := by_name.get("box")) is not None:
            length = _between(_BOX, drawn[:, 1:3]) * (width, height)
            start = (0.5 + 0.5 * drawn[:, 3:5]) * ((width, height) - length)
            end = np.where(drawn[:, :1] < -1 / 3, start + length, start)
            level = 127.5 + 127.5 * drawn[:, 5:]
            box = np.concatenate([start, end, level], axis=1).astype(np.int64)
        noise, piece = None, np.zeros(len(samples), np.int64)
        if (drawn := by_name.get("noise")) is not None:
            noise = _between((0, _NOISE), drawn[:, 0])
            piece = _between((0, _PIECES), drawn[:, 1]).astype(np.int64)
        return Drawn(_matrix(by_name, height, width), _colours(by_name), shade, strip, box, noise, piece)

    def _draws(self, epoch: int, samples: Numbers, part: slice, stream: int = 0) -> Floats:
        """Random values (N, K) in -1..1. SplitMix64 (Steele et al. 2014) computes any of them directly, without
        the previous ones."""
        counter = samples[:, None].astype(np.uint64) * np.uint64(_MAX_DRAWS)
        counter = counter + np.arange(part.start + 1, part.stop + 1, dtype=np.uint64)
        mixed = _key(self.seed, epoch, stream) + counter * np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
        return (mixed >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1


@lru_cache(maxsize=8)
def _key(seed: int, epoch: int, stream: int) -> np.uint64:
    entropy = (seed, epoch, stream) if stream else (seed, epoch)  # as in the version that had only one
    return np.uint64(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0])


def _matrix(draws: Mapping[EpochAlteration, Floats], height: int, width: int) -> Floats | None:
    """The matrices (N, 2, 3) that zoom and turn around the middle, then move: from px of the new picture to px of
    the old one."""
    count = max((len(draws[name]) for name in ("move", "zoom", "turn") if name in draws), default=0)
    if not count:
        return None
    still = np.zeros((count, 2))
    scale = 1 / (1 + _ZOOM * draws.get("zoom", still)[:, 0])
    angle = _TURN_RAD * draws.get("turn", still)[:, 0]
    shift = draws.get("move", still) * _MOVE * (width, height)
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    matrix = np.empty((count, 2, 3))
    matrix[:, 0, 0], matrix[:, 0, 1] = cosine, sine
    matrix[:, 1, 0], matrix[:, 1, 1] = -sine, cosine
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    matrix[:, :, 2] = middle - (matrix[:, :, :2] @ (middle + shift)[:, :, None])[:, :, 0]
    return matrix


def _colours(draws: Mapping[EpochAlteration, Floats]) -> Floats | None:
    """The matrices (N, 3, 4) that change the contrast around middle grey, the brightness, and each colour, and
    then mix the colours."""
    names: tuple[EpochAlteration, ...] = ("contrast", "brightness", "colours", "mix")
    count = max((len(draws[name]) for name in names if name in draws), default=0)
    if not count:
        return None
    none = np.zeros((count, 1))
    contrast = 1 + _CONTRAST * draws.get("contrast", none)
    colours = np.zeros((count, 3, 4))
    colours[:, (0, 1, 2), (0, 1, 2)] = contrast * (1 + _COLOUR * draws.get("colours", none))
    colours[:, :, 3] = _MIDDLE * (1 - contrast) + _BRIGHTNESS * draws.get("brightness", none)
    if "mix" in draws:
        mix = _mix(draws["mix"])
        colours = mix @ colours
        colours[:, :, 3] += _MIDDLE * (1 - mix.sum(axis=2))
    return colours


def _mix(draws: Floats) -> Floats:
    """The matrices (N, 3, 3) that replace a random part of the colours by random shares of all three colours. A
    share may be negative; all together keep about the contrast of grey."""
    shares = draws[:, 2:].reshape(-1, 3, 3)
    light = np.sqrt(np.mean(shares.sum(axis=2) ** 2, axis=1))
    shares = shares / np.maximum(light, _MIN_LIGHT)[:, None, None]
    part = np.where(draws[:, 0] < 2 * _MIXED - 1, _between((0, 1), draws[:, 1]), 0)[:, None, None]
    mix: Floats = (1 - part) * np.eye(3) + part * shares
    return mix


def _alter(picture: Image, drawn: Drawn, number: int) -> None:
    height, width = picture.shape[:2]
    if drawn.matrix is not None:
        bgra = cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA)  # OpenCV warps four channels in half the time of three
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(bgra, drawn.matrix[number], (width, height), None, flags, cv2.BORDER_REPLICATE)
        cv2.cvtColor(moved, cv2.COLOR_BGRA2BGR, picture)
    if drawn.colours is not None:
        cv2.transform(picture, drawn.colours[number], picture)
    if drawn.shade is not None and (shade := float(drawn.shade[number])) < 1:
        mask = np.zeros((height, width), np.uint8)
        cv2.fillConvexPoly(mask, drawn.strip[number], 1)
        cv2.copyTo(cv2.convertScaleAbs(picture, alpha=shade), mask, picture)
    if drawn.box is not None:
        left, top, right, bottom, level = drawn.box[number].tolist()
        if left < right:
            picture[top:bottom, left:right] = level
    if drawn.noise is not None:
        share, piece = float(drawn.noise[number]) / NOISE_LEVEL, int(drawn.piece[number])
        noise = noise_of(picture.size)[piece : piece + picture.size].reshape(picture.shape)
        cv2.addWeighted(picture, 1, noise, share, -128 * share, picture)


@cache
def noise_of(size: int) -> Image:
    """Noise around 128, (size + _PIECES,) uint8; a picture of `size` values uses a piece of it."""
    random = np.random.default_rng(0)
    return np.clip(random.normal(128, NOISE_LEVEL, size + _PIECES).round(), 0, 255).astype(np.uint8)


def _between(bounds: tuple[float, float], drawn: Floats) -> Floats:
    """Scale random values in -1..1 to these bounds."""
    return bounds[0] + (bounds[1] - bounds[0]) * (0.5 + 0.5 * drawn)


def blur(picture: Image, random: np.random.Generator) -> Image:
    """Gaussian blur with an odd kernel of 3 to 9 pixels."""
    kernel_px = 2 * int(random.integers(1, 5)) + 1
    return cv2.GaussianBlur(picture, (kernel_px, kernel_px), 0).astype(np.uint8, copy=False)


def brightness(picture: Image, random: np.random.Generator) -> Image:
    """Multiply the value channel of HSV by 0.4 to 1.6: pictures become darker as often as brighter."""
    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    hsv[:, :, 2] = cv2.convertScaleAbs(hsv[:, :, 2], alpha=random.uniform(0.4, 1.6))
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR).astype(np.uint8, copy=False)


def shadow(picture: Image, random: np.random.Generator) -> Image:
    """Darken one to five polygons of three to six corners to 0.45 to 0.74 of their brightness."""
    height, width = picture.shape[:2]
    mask = np.zeros((height, width), np.uint8)
    for _ in range(int(random.integers(1, 6))):
        corners = random.integers((0, 0), (width, height), size=(int(random.integers(3, 7)), 2))
        cv2.fillPoly(mask, [corners.astype(np.int32)], 255)
    darker = cv2.convertScaleAbs(picture, alpha=random.uniform(0.45, 0.74))
    return np.where(mask[:, :, None] > 0, darker, picture).astype(np.uint8, copy=False)


ALTERATIONS: Final[dict[str, Callable[[Image, np.random.Generator], Image]]] = {
    "blur": blur,
    "brightness": brightness,
    "shadow": shadow,
}


def alter(picture: Image, names: str, seed: int) -> Image:
    """Apply the alterations `names` ("blur+shadow"; "" for none) in this order, with the random generator `seed`.

    Raises DatasetError for an unknown or repeated name, or a negative seed.
    """
    wanted = names.split("+") if names else []
    if seed < 0 or not ALTERATIONS.keys() >= set(wanted) or len(set(wanted)) < len(wanted):
        raise DatasetError(
            f"{names!r} with seed {seed} is not an alteration; build the index again with `bc-index`"
        )
    random = np.random.default_rng(seed)
    for name in wanted:
        picture = ALTERATIONS[name](picture, random)
    return picture
