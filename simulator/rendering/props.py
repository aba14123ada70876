"""The props next to the road: trees, bushes, boulders and posts. Each is a flat picture that faces the camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.rendering.noise import Field
from simulator.rendering.terrain import CELL_M, Terrain
from simulator.roads.centreline import Floats
from simulator.roads.track import Track

Sprite = NDArray[np.uint8]  # (rows, columns, 4) BGRA; the lowest row touches the ground

PINE, PALM, BUSH, BOULDER, POST = range(5)
HEIGHTS_M = {PINE: (6.0, 12.0), PALM: (4.5, 7.5), BUSH: (0.8, 2.2), BOULDER: (0.8, 2.5), POST: (1.0, 1.0)}
FROM_EDGE_M = {PINE: (4.0, 45.0), PALM: (3.0, 20.0), BUSH: (2.2, 25.0), BOULDER: (2.5, 20.0), POST: (0.9, 0.9)}
POSTS_EVERY_M = 18.0
STEEPEST = 0.9  # maximum rise over run of the ground under a prop
SIZE_PX = 128
SUN = (0.5, 0.35, 0.8)  # the direction to the sun: east, north, up


def place_props(track: Track, terrain: Terrain, random: np.random.Generator) -> Floats:
    """Place props along the road: (P, 5) float64 of x, y, z of the foot, height in metres, and kind.

    No prop is on another stretch of the road, in the water, or on a bridge.
    """
    line, rows = track.line, []
    for k in range(len(line.points_m)):
        look = track.looks[track.look_index[k]]
        for side, edge in ((1.0, look.left), (-1.0, look.right)):
            kinds = (PALM, BUSH, BUSH, BOULDER) if look.jungle else (PINE, PINE, BUSH, BOULDER)
            kind = kinds[int(random.integers(4))]
            post = (
                edge.kind in ("line", "dirt") and edge.bank_m < 2.0 and k % round(POSTS_EVERY_M / line.step_m) == 0
            )
            if post:
                kind = POST
            elif random.random() > edge.props_per_100m * line.step_m / 100.0:
                continue
            near, far = FROM_EDGE_M[kind]
            # More props near the road, where they are visible.
            away = track.half_width_m[k] + near + (far - near) * random.random() ** 1.5
            x = line.points_m[k, 0] - side * away * np.sin(line.heading_rad[k])
            y = line.points_m[k, 1] + side * away * np.cos(line.heading_rad[k])
            rows.append((x, y, 0.0, random.uniform(*HEIGHTS_M[kind]), kind))
    props = np.array(rows, dtype=np.float64).reshape(-1, 5)
    column, row = (np.round((props[:, i] - terrain.origin_m[i]) / CELL_M).astype(int) for i in (0, 1))
    props[:, 2] = terrain.height_m[row, column] - 0.05
    clear = terrain.beyond_m[row, column] > np.where(props[:, 4] == POST, 0.7, 2.0)
    # No props on rock faces.
    rise = np.hypot(
        *(cv2.Sobel(terrain.height_m, cv2.CV_32F, *d, scale=1 / (8 * CELL_M)) for d in ((1, 0), (0, 1)))
    )
    clear &= rise[row, column] < STEEPEST
    return np.asarray(props[clear & (props[:, 2] > terrain.water_level_m + 0.2)], dtype=np.float64)


def cast_shadows(track: Track, terrain: Terrain, props: Floats, random: np.random.Generator) -> NDArray[np.uint8]:
    """The light under the shadows of props and of branches over shaded stretches: (rows, columns) uint8; 255: full
    light."""
    light = np.full(terrain.height_m.shape, 255, np.uint8)
    reach = np.array([-SUN[0], -SUN[1]]) / SUN[2]

    def cell(x_m: float, y_m: float) -> tuple[int, int]:
        return round((x_m - terrain.origin_m[0]) / CELL_M), round((y_m - terrain.origin_m[1]) / CELL_M)

    for x, y, _, height, kind in props:
        if kind == POST:
            continue
        top = (x + reach[0] * height, y + reach[1] * height)
        if kind in (PINE, PALM):
            cv2.line(light, cell(x, y), cell(*top), 120, 1)
        centre = cell(0.3 * x + 0.7 * top[0], 0.3 * y + 0.7 * top[1])
        cv2.circle(light, centre, max(1, round(0.22 * height / CELL_M)), 115, -1)
    line = track.line
    for k in range(0, len(line.points_m), max(1, round(1.5 / line.step_m))):
        if random.random() > track.looks[track.look_index[k]].shade:
            continue
        side = np.array([-np.sin(line.heading_rad[k]), np.cos(line.heading_rad[k])])
        ahead = np.array([side[1], -side[0]])
        start, end = sorted(random.uniform(-9.0, 9.0, 2))
        foot = line.points_m[k, :2] + start * side
        tip = line.points_m[k, :2] + end * side + random.uniform(-3.0, 3.0) * ahead
        cv2.line(light, cell(*foot), cell(*tip), 125, int(random.integers(2, 5)))
    return np.asarray(cv2.GaussianBlur(light, (0, 0), 0.8), dtype=np.uint8)


def draw_sprites() -> dict[int, list[Sprite]]:
    """The pictures of each kind of prop, up to three variants, 128 px high."""
    random = np.random.default_rng(5)
    painters = {PINE: _pine, PALM: _palm, BUSH: _bush, BOULDER: _boulder, POST: _post}
    return {kind: [paint(random) for _ in range(1 if kind == POST else 3)] for kind, paint in painters.items()}


def _blobs(
    random: np.random.Generator, sprite: Sprite, centres: Floats, radius_px: float, dark: Floats, bright: Floats
) -> None:
    """Draw foliage: discs from dark to bright, one over the other."""
    for depth, (x, y) in enumerate(centres):
        colour = dark + (bright - dark) * (depth / len(centres)) * random.uniform(0.6, 1.0)
        radius = max(1, round(radius_px * random.uniform(0.5, 1.0)))
        cv2.circle(sprite, (round(x), round(y)), radius, (*colour.tolist(), 255), -1, cv2.LINE_AA)


def _pine(random: np.random.Generator) -> Sprite:
    sprite = np.zeros((SIZE_PX, 72, 4), np.uint8)
    cv2.line(sprite, (36, 127), (36, 15), (32, 44, 58, 255), 3, cv2.LINE_AA)
    count = 150
    y = np.sort(random.uniform(6, 88, count) + random.uniform(0, 6, count))[::-1]
    spread = (y - 2) * random.uniform(0.22, 0.34)
    x = 36 + spread * random.uniform(-1, 1, count)
    order = random.permutation(count)
    _blobs(random, sprite, np.stack([x, y], 1)[order], 5.0, np.array([18.0, 34, 28]), np.array([48.0, 92, 84]))
    return sprite


def _palm(random: np.random.Generator) -> Sprite:
    sprite = np.zeros((SIZE_PX, 128, 4), np.uint8)
    lean = random.uniform(-14, 14)
    height = np.linspace(0, 1, 12)
    trunk = np.stack([64 + lean * height**2, 127 - 88 * height], axis=1)
    cv2.polylines(sprite, [np.round(trunk).astype(np.int32)], False, (52, 66, 78, 255), 5, cv2.LINE_AA)
    for angle in np.concatenate([random.uniform(-0.3, np.pi + 0.3, 16), random.uniform(-0.6, np.pi + 0.6, 8)]):
        t = np.linspace(0, 1, 8)
        length = random.uniform(34, 52)
        frond = trunk[-1] + np.stack([t * length * np.cos(angle), 30 * t**2 - t * length * np.sin(angle) * 0.7], 1)
        shade = random.uniform(0.5, 1.1)
        colour = (24 * shade, 74 * shade, 58 * shade, 255)
        cv2.polylines(
            sprite, [np.round(frond).astype(np.int32)], False, colour, int(random.integers(3, 6)), cv2.LINE_AA
        )
    return sprite


def _bush(random: np.random.Generator) -> Sprite:
    sprite = np.zeros((SIZE_PX, 192, 4), np.uint8)
    angle, radius = random.uniform(0, np.pi, 130), np.sqrt(random.uniform(0, 1, 130))
    centres = np.stack([96 + 78 * radius * np.cos(angle), 122 - 96 * radius * np.sin(angle)], axis=1)
    _blobs(random, sprite, centres, 13.0, np.array([14.0, 34, 30]), np.array([36.0, 98, 88]))
    return sprite


def _boulder(random: np.random.Generator) -> Sprite:
    sprite = np.zeros((SIZE_PX, 176, 4), np.uint8)
    angle = np.linspace(0, np.pi, 14)
    radius = random.uniform(0.75, 1.0, 14)
    outline = np.stack([88 + 84 * radius * np.cos(angle), 127 - 118 * radius * np.sin(angle)], axis=1)
    cv2.fillPoly(sprite, [np.round(outline).astype(np.int32)], (74, 86, 90, 255), cv2.LINE_AA)
    inside = sprite[..., 3] == 255
    shade = np.linspace(1.25, 0.55, SIZE_PX)[:, None] + 0.15 * random.normal(size=(SIZE_PX // 8, 22)).repeat(
        8, 0
    ).repeat(8, 1)
    colours = np.clip(sprite[..., :3] * shade[..., None], 0, 255).astype(np.uint8)
    sprite[..., :3] = np.where(inside[..., None], cv2.blur(colours, (5, 5)), sprite[..., :3])
    return sprite


def _post(random: np.random.Generator) -> Sprite:
    sprite = np.zeros((SIZE_PX, 24, 4), np.uint8)
    sprite[4:, 4:20] = (205, 210, 212, 255)
    sprite[18:44, 4:20] = (40, 40, 46, 255)
    sprite[24:38, 8:16] = (60, 60, 200, 255)
    return sprite


NEAR_M, FAR_M = 1.5, 150.0
FADE_M = 30.0  # props fade in over this distance before FAR_M
MIN_SIZE_PX = 3.0


class PropsView:
    """The props of one world, (P, 5), from ``props.place_props``."""

    def __init__(self, props: Floats) -> None:
        self._props = props
        sprites = {kind: [_halvings(s) for s in variants] for kind, variants in draw_sprites().items()}
        variants = [sprites[int(kind)] for kind in props[:, 4]]
        self._sprites = [levels[k % len(levels)] for k, levels in enumerate(variants)]
        self._last_halving = np.array([len(levels) - 1 for levels in self._sprites])

    def draw(
        self,
        picture: NDArray[np.uint8],
        inverse: Field,
        eye_m: tuple[float, float, float],
        heading_rad: float,
        to_camera: Floats,
        focal_px: float,
    ) -> None:
        """Draw the props into a BGRA picture, far props first. ``inverse`` has 1 / distance ahead to the ground
        (1/m) for each pixel."""
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        east, north, up = (self._props[:, :3] - eye_m).T
        ahead, left = east * cos + north * sin, north * cos - east * sin
        foot = to_camera @ np.stack([ahead, left, up])
        depth = np.maximum(foot[0], 1e-3)
        size_px = self._props[:, 3] * focal_px / depth
        height, width = inverse.shape
        column, row = width / 2 - focal_px * foot[1] / depth, height / 2 - focal_px * foot[2] / depth
        is_visible = (
            (ahead > NEAR_M)
            & (ahead < FAR_M)
            & (size_px > MIN_SIZE_PX)
            & (np.abs(column - width / 2) < width / 2 + size_px)
        )
        seen = np.flatnonzero(is_visible)[np.argsort(-ahead[is_visible], kind="stable")]
        ahead, size_px = ahead[seen], size_px[seen]
        halvings = np.clip(np.log2(SIZE_PX / size_px), 0, self._last_halving[seen]).astype(int)
        sprites = [self._sprites[k][halving] for k, halving in zip(seen.tolist(), halvings.tolist(), strict=True)]
        stamps = _Stamps(sprites, column[seen], row[seen], size_px, (width, height))
        strengths = (np.minimum(1.0, (FAR_M - ahead) / FADE_M) / 255.0).astype(np.float32)
        # Nearer ground hides a prop.
        free = inverse.ravel()[stamps.place] < (1 / ahead * 1.02)[stamps.sprite]
        colours = stamps.colours(np.bincount(stamps.sprite, free, len(sprites)) > 0)
        alpha = colours[:, 3] * free * strengths[stamps.sprite]
        _blend(picture.view(np.uint32).ravel(), stamps.place, colours.view(np.uint32).ravel(), alpha)


class _Stamps:
    """Sprites at their places in a picture. Their N pixels are ordered by sprite, then row by row."""

    def __init__(
        self, sprites: list[Sprite], column: Floats, foot: Floats, size_px: Floats, picture_px: tuple[int, int]
    ) -> None:
        """The foot of each sprite is at ``column`` and row ``foot``; its height is ``size_px``."""
        height, width = np.array([sprite.shape[:2] for sprite in sprites]).reshape(-1, 2).T
        scale = size_px / height
        left, top = column - width * scale / 2, foot - size_px
        x0, y0 = np.maximum(0, np.floor(left)).astype(int), np.maximum(0, np.floor(top)).astype(int)
        x1 = np.minimum(picture_px[0], np.ceil(left + width * scale)).astype(int)
        y1 = np.minimum(picture_px[1], np.ceil(foot)).astype(int)
        self._sprites = sprites
        self._columns, self._rows = np.maximum(0, x1 - x0), np.maximum(0, y1 - y0)
        # For sub-pixel placement: the sprite's coordinates at the centres of the picture's pixels.
        self._affine = np.zeros((len(sprites), 2, 3))
        self._affine[:, 0, 0] = self._affine[:, 1, 1] = 1 / scale
        self._affine[:, 0, 2] = (x0 + 0.5 - left) / scale - 0.5
        self._affine[:, 1, 2] = (y0 + 0.5 - top) / scale - 0.5
        sizes = self._columns * self._rows
        self._ends = np.cumsum(sizes)
        self.sprite = np.repeat(np.arange(len(sprites)), sizes)  # the number of each pixel's sprite
        within = np.arange(len(self.sprite)) - (self._ends - sizes)[self.sprite]
        row = within // self._columns[self.sprite]
        rest = (picture_px[0] - self._columns)[self.sprite]  # columns of the picture outside the sprite
        self.place = (y0 * picture_px[0] + x0)[self.sprite] + row * rest + within  # position in the flat picture

    def colours(self, is_shown: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """The pixels' colours, (N, 4) BGRA; 0 for sprites that are not shown."""
        colours = np.zeros((len(self.sprite), 4), np.uint8)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        columns, rows, ends = self._columns.tolist(), self._rows.tolist(), self._ends.tolist()
        for k in np.flatnonzero(is_shown).tolist():
            size = columns[k], rows[k]
            patch = colours[ends[k] - size[0] * size[1] : ends[k]].reshape(size[1], size[0], 4)
            cv2.warpAffine(self._sprites[k], self._affine[k], size, patch, flags, cv2.BORDER_CONSTANT)
        return colours


def _blend(
    picture: NDArray[np.uint32], pixels: NDArray[np.int64], colours: NDArray[np.uint32], alpha: Field
) -> None:
    """Blend colours (N,) over the pixels (N,) of a picture (P,); a BGRA colour is one word. If a pixel occurs
    twice, it is blended twice, in this order."""
    shown = np.flatnonzero(alpha)
    pixels, colours, alpha = pixels[shown], colours[shown], alpha[shown]
    earliest = np.empty(len(picture), np.intp)
    while len(pixels):
        # In each round, blend the first remaining colour of every pixel.
        count = np.arange(len(pixels))
        earliest[pixels[::-1]] = count[::-1]
        is_first = earliest[pixels] == count
        at = pixels[is_first]
        under = picture[at].view(np.uint8)
        blend = cv2.subtract(colours[is_first].view(np.uint8), under, dtype=cv2.CV_32F).ravel()
        blend *= np.repeat(alpha[is_first], 4)
        blend += under
        blend += np.float32(0.5)
        picture[at] = blend.astype(np.uint8).view(np.uint32)
        later = ~is_first
        pixels, colours, alpha = pixels[later], colours[later], alpha[later]


def _halvings(sprite: Sprite) -> list[Sprite]:
    """The sprite at 1, 1/2, 1/4, ... of its size, averaged with colours weighted by opacity, so that small sprites
    do not flicker."""
    levels = [sprite]
    alpha = sprite[..., 3:].astype(np.float32)
    weighted = np.dstack([sprite[..., :3] * alpha, alpha])
    while weighted.shape[0] > 8:
        weighted = cv2.resize(
            weighted, (max(1, weighted.shape[1] // 2), weighted.shape[0] // 2), interpolation=cv2.INTER_AREA
        )
        colour = weighted[..., :3] / np.maximum(weighted[..., 3:], 1e-3)
        levels.append(np.dstack([colour, weighted[..., 3:]]).astype(np.uint8))
    return levels
