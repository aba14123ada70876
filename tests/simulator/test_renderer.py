"""What the simulator's cameras show, checked against a pinhole camera computed here."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from common.car import Camera
from simulator.pose import Pose
from simulator.rendering.camera import MOUNT_FORWARD_M, Renderer
from simulator.rendering.raycast import COLUMNS, ROWS, Eye, RayCaster
from simulator.rendering.terrain import CELL_M
from simulator.rendering.world_maps import WorldMaps, build_world
from simulator.roads.road_stretches import Edge, Look, Stretch, trace
from simulator.roads.track import Track, load_track, make_track

LINED = Look("asphalt", Edge("line", 0.0, 0.0), Edge("line", 0.0, 0.0), 3.8, jungle=True)


@pytest.fixture(scope="module")
def flat() -> Track:
    """A flat stadium whose first 120 m lead straight to the east, with white lines 0.3 m inside its edges."""
    straight, bend = Stretch(120, 0, 0.0, LINED), Stretch(120, 180, 0.0, LINED)
    points, index = trace([straight, bend, straight, bend])
    return make_track("flat", points, (LINED,), np.zeros_like(index))


@pytest.fixture(scope="module")
def flat_world(flat: Track) -> WorldMaps:
    return build_world(flat, cache=False)


@pytest.fixture(scope="module")
def mountain_world() -> WorldMaps:
    return build_world(load_track("mountain"), cache=False)


def on_road(track: Track, world: WorldMaps, arc_m: float) -> Pose:
    place = track.line.at(arc_m)
    height = world.height_m(place.x_m, place.y_m)
    return Pose(place.x_m, place.y_m, height, place.heading_rad, float(np.arctan(place.slope)))


def pixel(ahead_m: float, left_m: float, height_m: float = 1.4) -> tuple[float, float]:
    """(row, column) of a point of level ground, from a pinhole so high up with a 60 degree vertical field of
    view and the horizon at row 60 of 160."""
    focal = 80 / np.tan(np.radians(30))
    tilt = np.arctan(20 / focal)
    depth = ahead_m * np.cos(tilt) + height_m * np.sin(tilt)
    up = ahead_m * np.sin(tilt) - height_m * np.cos(tilt)
    return 80 - focal * up / depth, 160 - focal * left_m / depth


def test_the_same_pose_gives_the_same_bytes(mountain_world: WorldMaps) -> None:
    pose = on_road(load_track("mountain"), mountain_world, 130.0)
    first, second = Renderer(mountain_world), Renderer(mountain_world)
    picture = first.render(pose, "left")
    first.render(replace(pose, heading_rad=1.0))  # what was rendered before does not matter
    assert np.array_equal(picture, first.render(pose, "left"))
    assert np.array_equal(picture, second.render(pose, "left"))


def test_the_sky_is_above_and_the_bonnet_below(flat: Track, flat_world: WorldMaps) -> None:
    renderer = Renderer(flat_world)
    first, second = (renderer.render(on_road(flat, flat_world, arc)) for arc in (20.0, 190.0))
    top = first[:5].reshape(-1, 3).mean(axis=0)
    assert top[0] > top[2] + 30  # blue
    assert np.array_equal(first[155:, 120:200], second[155:, 120:200])  # the bonnet goes with the car
    assert not np.array_equal(first[120:125], second[120:125])


def test_every_pixel_is_sky_or_ground_or_stands_on_it(mountain_world: WorldMaps) -> None:
    """Nothing there is black: what nobody had drawn would be. Once the nose is so high that all is sky."""
    renderer, track = Renderer(mountain_world), load_track("mountain")
    for arc_m in (0.0, 150.0, 300.0):
        pose = on_road(track, mountain_world, arc_m)
        for pitch_rad in (pose.pitch_rad, 0.3, 1.2):
            assert renderer.render(replace(pose, pitch_rad=pitch_rad))[:110].any(axis=2).all()


@pytest.mark.parametrize(("camera", "mount_left_m"), [("center", 0.0), ("left", 0.9), ("right", -0.9)])
def test_a_line_is_where_a_pinhole_camera_sees_it(
    flat: Track, flat_world: WorldMaps, camera: Camera, mount_left_m: float
) -> None:
    picture = Renderer(flat_world).render(on_road(flat, flat_world, 20.0), camera)
    places = [pixel(ahead, left - mount_left_m) for ahead in (5.0, 8.0, 14.0) for left in (3.5, -3.5)]
    in_picture = [(row, column) for row, column in places if 8 < column < 312]
    assert len(in_picture) >= 4
    for row, column in in_picture:
        around = picture[round(row - 0.5), int(column) - 8 : int(column) + 9].mean(axis=1)
        assert around.max() > np.median(around) + 30
        assert abs(int(np.argmax(around)) - 8) <= 2


def test_far_ground_is_where_a_pinhole_camera_sees_it(flat_world: WorldMaps) -> None:
    """Seen from 20 m up, where a map without a road is red from 150 to 200 m ahead of the camera."""
    ground = np.zeros_like(flat_world.ground)
    east_m = np.arange(ground.shape[1]) * CELL_M
    ground[:, (east_m >= 200) & (east_m <= 250)] = 0, 0, 255
    level, nowhere = np.zeros_like(flat_world.height), np.full_like(flat_world.offset, 99.0)
    world = replace(flat_world, ground=ground, height=level, offset=nowhere, props=flat_world.props[:0])
    east_of_origin_m, north_of_origin_m = 50.0 - MOUNT_FORWARD_M, 100.0
    place = flat_world.origin_m[0] + east_of_origin_m, flat_world.origin_m[1] + north_of_origin_m
    picture = Renderer(world).render(Pose(*place, 20.0, 0.0, 0.0), "center").astype(int)
    rows = np.flatnonzero(picture[:, 160, 2] > picture[:, 160, 1] + 60)
    (first, _), (last, _) = (pixel(ahead_m, 0.0, 21.4) for ahead_m in (200.0, 150.0))
    assert (rows[0], rows[-1]) == pytest.approx((first, last), abs=1.5)


def test_the_horizon_follows_the_nose(flat: Track, flat_world: WorldMaps) -> None:
    pose = on_road(flat, flat_world, 20.0)
    renderer = Renderer(flat_world)

    def sky_rows(picture: NDArray[np.uint8]) -> int:
        return int((picture[:, :, 0].astype(int) > picture[:, :, 2] + 20).all(axis=1).sum())

    level, up = (sky_rows(renderer.render(replace(pose, pitch_rad=pitch))) for pitch in (0.0, 0.1))
    assert 8 <= up - level <= 20  # 138.6 px * tan(0.1) is 14


def test_a_wall_hides_what_is_behind_it() -> None:
    height = np.zeros((200, 400), np.float32)
    wall = 100 + round(20.0 / CELL_M)
    height[:, wall : wall + 10] = 3.0
    eye = Eye(column=100.0, row=100.0, height_m=1.4, cos=1.0, sin=0.0)
    table = RayCaster(height).inverse_distance(eye, side=(-0.1, 0.1), up=(-0.5, 0.5))
    middle = table[:, COLUMNS // 2]
    slope = np.linspace(-0.5, 0.5, ROWS)
    ground = slope < -0.08
    assert np.allclose(middle[ground], -slope[ground] / 1.4, rtol=1e-2)  # slope = -height / distance
    face = (slope > -0.06) & (slope < 0.07)  # the wall's top: 1.6 m above the eye, 20 m away
    assert np.allclose(1 / middle[face], 20.0, atol=0.7)
    assert np.all(middle[slope > 0.09] == 0)


@pytest.mark.parametrize("name", ["lake", "mountain"])
def test_the_ground_under_the_road_is_the_road(name: str) -> None:
    track = load_track(name)
    world = build_world(track, cache=False)
    for arc in np.arange(0.0, track.line.length_m, 7.0):
        place = track.line.at(arc)
        for left in (-3.0, 0.0, 3.0):
            x = place.x_m - left * np.sin(place.heading_rad)
            y = place.y_m + left * np.cos(place.heading_rad)
            assert world.height_m(x, y) == pytest.approx(place.z_m, abs=0.06)
