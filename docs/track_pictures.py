"""Pictures of the built-in tracks, and of where things lie in what their cameras see."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import Camera
from simulator.driving.course import Course
from simulator.rendering.camera import Renderer
from simulator.rendering.world_maps import build_world
from simulator.roads.track import Track, load_track

Picture = NDArray[np.uint8]

WIDTH: Final = 320
HEIGHT: Final = 160
WHITE, GREY, FIRST, SECOND = (255, 255, 255), (120, 120, 120), (60, 120, 230), (60, 170, 60)
BEFORE_HAIRPIN_M: Final = 28.0  # from its middle
# Measured on the published recordings: where the horizon, the bonnet and the network's crop lie.
HORIZON_ROW, BONNET_ROW, CROP_TOP_ROW, CROP_BOTTOM_ROW = 60, 137, 50, 140


def track_sheet(name: str) -> Picture:
    """The track from above, and what the centre camera sees at eight places along it."""
    track = load_track(name)
    world = build_world(track)
    renderer, course = Renderer(world), Course(track, world.height_m)
    views = []
    for k in range(8):
        course.start((k + 0.5) / 8 * track.line.length_m)
        picture = renderer.render(course.pose)
        cv2.putText(picture, str(k + 1), (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, WHITE, 2, cv2.LINE_AA)
        views.append(picture)
    grid = np.vstack([np.hstack(views[i : i + 2]) for i in range(0, 8, 2)])
    return np.hstack([overview(track, grid.shape[0]), grid]).astype(np.uint8)


FORM_VIEWS: Final = {
    "lake": ("lake", 0.75),
    "mountain": ("mountain", 0.3),
    "random": ("random:1", 0.45),
    "hairpins": ("hairpins:1", 0.05),
}
"""What bc-web's form *Drive* shows of each kind of track: a track, and the share of its length."""


def form_view(name: str) -> Picture:
    """What the centre camera sees on a kind of track."""
    track_name, share = FORM_VIEWS[name]
    track = load_track(track_name)
    world = build_world(track)
    course = Course(track, world.height_m)
    course.start(share * track.line.length_m)
    return Renderer(world).render(course.pose)


def overview(track: Track, size: int) -> Picture:
    """The road's plan, with the numbers of the views."""
    sheet, pixels = plan(track, size)
    for k in range(8):
        x, y = pixels[round((k + 0.5) / 8 * len(pixels))]
        cv2.circle(sheet, (x, y), 11, WHITE, -1, cv2.LINE_AA)
        cv2.circle(sheet, (x, y), 11, GREY, 1, cv2.LINE_AA)
        cv2.putText(sheet, str(k + 1), (x - 5, y + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, GREY, 1, cv2.LINE_AA)
    text = f"{track.name}: {track.line.length_m:.0f} m; blue: first half, green: second"
    cv2.putText(sheet, text, (16, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.55, GREY, 1, cv2.LINE_AA)
    return sheet


def hairpin_sheet() -> Picture:
    """Six roads with hairpins from above, and what the centre camera sees before a hairpin of each."""
    cells = []
    for seed in range(6):
        track = load_track(f"hairpins:{seed}")
        world = build_world(track)
        course = Course(track, world.height_m)
        sharpest_m = float(np.abs(track.line.curvature_per_m).argmax()) * track.line.step_m
        course.start(sharpest_m - BEFORE_HAIRPIN_M)
        sheet, _ = plan(track, WIDTH)
        text = f"{track.name}, {track.line.length_m:.0f} m"
        cv2.putText(sheet, text, (10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, GREY, 1, cv2.LINE_AA)
        cells.append(np.vstack([sheet, Renderer(world).render(course.pose)]))
    return np.vstack([np.hstack(cells[:3]), np.hstack(cells[3:])]).astype(np.uint8)


def plan(track: Track, size: int) -> tuple[Picture, list[tuple[int, int]]]:
    """The centre line from above, the first half in blue and the second in green, and its points in pixels."""
    points = track.line.points_m[:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    scale = (size - 80) / float((high - low).max())
    middle = (low + high) / 2

    pixels = [(round(size / 2 + x), round(size / 2 - y)) for x, y in (points - middle) * scale]
    sheet = np.full((size, size, 3), 250, np.uint8)
    half = len(points) // 2
    for i in range(len(points)):
        color = FIRST[::-1] if i < half else SECOND
        cv2.line(sheet, pixels[i], pixels[(i + 1) % len(pixels)], color, 5, cv2.LINE_AA)
    return sheet, pixels


def layout_sheet() -> Picture:
    """The layout of the real simulator's pictures, drawn as a plan, above ours on both tracks: three cameras."""
    rows = []
    for name in ("lake", "mountain"):
        track = load_track(name)
        world = build_world(track)
        course = Course(track, world.height_m)
        course.start(0.06 * track.line.length_m)
        renderer = Renderer(world)
        cameras: tuple[Camera, ...] = ("left", "center", "right")
        rows.append(np.hstack([with_lines(renderer.render(course.pose, camera)) for camera in cameras]))
    plan = np.hstack([with_lines(plan_of_real(shift)) for shift in (1, 0, -1)])
    return np.vstack([plan, *rows]).astype(np.uint8)


def plan_of_real(shift: int) -> Picture:
    """Where sky, land, road and bonnet are in the real simulator's pictures, in flat colours."""
    picture = np.full((HEIGHT, WIDTH, 3), (215, 180, 150), np.uint8)
    picture[HORIZON_ROW:] = (120, 175, 165)
    vanishing, bottom = WIDTH // 2, WIDTH // 2 + 100 * shift
    road = np.array([(vanishing - 8, HORIZON_ROW + 2), (vanishing + 8, HORIZON_ROW + 2), (bottom + 420, HEIGHT),
                     (bottom - 420, HEIGHT)])  # fmt: skip
    cv2.fillPoly(picture, [road.astype(np.int32)], (110, 110, 110))
    cv2.ellipse(
        picture, (WIDTH // 2 + 105 * shift, HEIGHT), (82, HEIGHT - BONNET_ROW), 0, 180, 360, (90, 70, 60), -1
    )
    return picture


def with_lines(picture: Picture) -> Picture:
    """The crop's bounds and the horizon as lines."""
    marked = picture.copy()
    for row, color in ((CROP_TOP_ROW, WHITE), (CROP_BOTTOM_ROW, WHITE), (HORIZON_ROW, (80, 80, 255))):
        cv2.line(marked, (0, row), (WIDTH - 1, row), color, 1)
    return marked
