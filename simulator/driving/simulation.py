"""The built-in simulator: a track, its world, a car on it, and the car's cameras."""

from __future__ import annotations

import cv2

from common.car import Camera
from simulator.driving.course import Course
from simulator.pose import Pose
from simulator.rendering.camera import Picture, Renderer
from simulator.rendering.world_maps import build_world
from simulator.roads.track import load_track

JPEG_QUALITY = 75  # Unity's default: the files are as large as those of Udacity's simulator


class Simulation:
    """A car at rest at the start of a track. Raises ValueError if the track does not exist."""

    def __init__(self, track: str) -> None:
        self.track = load_track(track)
        world = build_world(self.track)
        self.course = Course(self.track, world.height_m)
        self._renderer = Renderer(world)

    def picture(self, camera: Camera = "center", pose: Pose | None = None, scale: float = 1.0) -> Picture:
        """A camera's picture, (160, 320, 3) uint8 BGR, at the car's pose or at another pose. ``scale`` enlarges
        it, for people."""
        return self._renderer.render(pose or self.course.pose, camera, scale)

    def jpeg(self, camera: Camera = "center", pose: Pose | None = None, scale: float = 1.0) -> bytes:
        picture = self.picture(camera, pose, scale)
        ok, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if not ok:  # never expected; without this, the picture would be lost silently
            raise RuntimeError("OpenCV could not write a JPEG")
        return encoded.tobytes()
