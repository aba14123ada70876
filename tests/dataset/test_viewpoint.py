"""The picture from beside where one was taken is the one that a camera there takes, of a level road."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from common.car import CAMERAS
from dataset.preprocessing import Image, decode
from dataset.viewpoint import Viewpoint
from painted_road import render
from recorder.log.session_car import UDACITY, Car, built_in
from simulator.driving.simulation import Simulation

WITHOUT_BONNET = replace(UDACITY, bonnet=dict.fromkeys(CAMERAS, ((0, 160), (320, 160))))
OTHER_CAR = replace(
    WITHOUT_BONNET,
    focal=1.2,
    horizon=0.42,
    height_m=0.8,
    forward_m=-0.3,
    left_m={"center": 0.0, "left": 0.4, "right": -0.4},
)


def known_share(warped: Image, true: Image) -> float:
    """The share of pixels that are right: the others lie where the camera has seen nothing."""
    return float((np.abs(warped.astype(float) - true).max(axis=2) < 12).mean())


@pytest.mark.parametrize("geometry", [WITHOUT_BONNET, OTHER_CAR])
@pytest.mark.parametrize(("left_m", "turn_deg"), [(0.7, 0), (0, 8), (0.5, -6), (-1.1, 10)])
def test_it_is_the_picture_that_a_camera_there_takes(geometry: Car, left_m: float, turn_deg: float) -> None:
    turn_rad = math.radians(turn_deg)
    taken = render(geometry)
    there = render(geometry, left_m=left_m, turn_rad=turn_rad)
    warped = Viewpoint(geometry, 320, 160).picture(taken, left_m, turn_rad)
    assert known_share(warped, there) > 0.6
    assert known_share(warped, there) > 1.5 * known_share(taken, there)


@pytest.mark.parametrize(("width_px", "height_px"), [(160, 80), (320, 240), (640, 320)])
def test_pictures_of_another_size_show_the_same_part_of_the_world(width_px: int, height_px: int) -> None:
    taken = render(WITHOUT_BONNET, width_px=width_px, height_px=height_px)
    there = render(WITHOUT_BONNET, left_m=0.5, turn_rad=0.1, width_px=width_px, height_px=height_px)
    warped = Viewpoint(WITHOUT_BONNET, width_px, height_px).picture(taken, 0.5, 0.1)
    assert known_share(warped, there) > 0.6


def test_at_the_cars_own_place_the_picture_is_the_recorded_one() -> None:
    taken = render(UDACITY)
    assert (Viewpoint(UDACITY, 320, 160).picture(taken, 0.0, 0.0) == taken).all()


def test_what_no_camera_saw_goes_on_as_at_the_edge() -> None:
    """A camera that turns to the left by 30 degrees sees on its left what was beyond the picture's edge."""
    bright = np.full((160, 320, 3), 200, np.uint8)
    assert (Viewpoint(WITHOUT_BONNET, 320, 160).picture(bright, 0.0, math.radians(30)) == 200).all()


def test_the_bonnet_stays_where_it_is_and_is_drawn_nowhere_else() -> None:
    geometry = replace(UDACITY, bonnet=dict.fromkeys(CAMERAS, ((100, 160), (100, 120), (220, 120), (220, 160))))
    is_bonnet = np.zeros((160, 320), np.bool_)
    is_bonnet[120:, 100:220] = True
    taken = np.where(is_bonnet, 255, 60)[..., None].repeat(3, axis=2).astype(np.uint8)
    for left_m in (0.3, 0.9, -1.2):
        warped = Viewpoint(geometry, 320, 160).picture(taken, left_m, 0.05)
        assert (warped[is_bonnet] == 255).all()
        assert (warped[~is_bonnet] == 60).all()


@pytest.mark.parametrize(("width_px", "height_px"), [(320, 240), (800, 320), (160, 80)])
def test_the_bonnet_is_as_wide_as_high_in_pictures_of_another_shape(width_px: int, height_px: int) -> None:
    """Lengths are shares of the height, also to either side of the middle."""
    geometry = replace(UDACITY, bonnet=dict.fromkeys(CAMERAS, ((140, 160), (140, 120), (180, 120), (180, 160))))
    taken = np.full((height_px, width_px, 3), 60, np.uint8)
    row, middle, half = height_px * 3 // 4, width_px // 2, height_px // 8
    taken[row:, middle - half : middle + half] = 255
    assert (Viewpoint(geometry, width_px, height_px).picture(taken, 0.3, 0.05) == taken).all()


def test_in_the_built_in_simulator_it_is_nearer_to_its_rendering() -> None:
    """Its lake begins on a level stretch; 20 rows below the horizon, as far as the bonnet."""
    simulation = Simulation("lake")
    pose = simulation.course.pose
    taken = decode(simulation.jpeg("center", pose))
    there = replace(
        pose,
        x_m=pose.x_m - 0.4 * math.sin(pose.heading_rad),
        y_m=pose.y_m + 0.4 * math.cos(pose.heading_rad),
        heading_rad=pose.heading_rad - 0.1,
    )
    true = decode(simulation.jpeg("center", there)).astype(float)
    warped = Viewpoint(built_in(), 320, 160).picture(taken, 0.4, -0.1)
    road = slice(60, 132), slice(60, 260)  # what lies farther to the right, nobody has seen
    assert np.abs(warped - true)[road].mean() < 0.5 * np.abs(taken - true)[road].mean()


@pytest.mark.parametrize(("left_m", "turn_rad"), [(0.0, 1.2), (math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0)])
def test_a_view_that_no_camera_has_a_part_of_is_refused(left_m: float, turn_rad: float) -> None:
    with pytest.raises(ValueError, match="no picture can be warped"):
        Viewpoint(UDACITY, 320, 160).picture(render(UDACITY), left_m, turn_rad)
    with pytest.raises(ValueError, match="a picture of"):
        Viewpoint(UDACITY, 320, 200).picture(render(UDACITY), 0.1, 0.0)
