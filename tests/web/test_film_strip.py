"""The film strip of a session's pictures, of whatever shape they are."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.car import Camera
from recorder import Log
from tests.helpers.logs import write_log
from web.logs.film_strip import film_strip
from web.processes.picture_maps import groups


@pytest.mark.parametrize("shape", [(1, 60_000), (60_000, 1), (1, 1), (161, 401)])
def test_pictures_of_any_shape_are_cut_to_their_middle_in_little_memory(
    tmp_path: Path, shape: tuple[int, int]
) -> None:
    """White in their middle and black at the edges. Made as high as the strip before it is cut, a picture of one
    row would take more than a gigabyte."""
    height, width = shape

    def picture(camera: Camera, row: int) -> bytes:
        drawn = np.zeros((height, width, 3), np.uint8)
        drawn[height // 3 : height - height // 3, width // 3 : width - width // 3] = 255
        return cv2.imencode(".jpg", drawn)[1].tobytes()

    with Log(write_log(tmp_path / "a.mcap", [0.0] * 8, picture, cameras=["center"])) as log:
        tracemalloc.start()
        try:
            encoded = film_strip(log)
            _, max_bytes = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    shown = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    assert shown.shape == (80, 640, 3)
    assert all(shown[30:50, left + 70 : left + 90].min() > 200 for left in range(0, 640, 160))
    assert max_bytes < 50e6


def test_groups_are_those_that_lie_together_the_largest_first() -> None:
    random = np.random.default_rng(0)
    places = [random.normal(at, 0.1, (count, 2)) for at, count in (((0, 0), 20), ((9, 0), 70), ((0, 9), 40))]
    group = groups(np.concatenate(places).astype(np.float32), 3)
    assert [set(part) for part in np.split(group, [20, 90])] == [{2}, {0}, {1}]
    assert set(groups(np.zeros((3, 2), np.float32), 24)) == {0}
