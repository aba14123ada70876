"""The far field of a session's pictures, and the car's turn from one picture to the next.

Distant things move across the picture when the car turns, and hardly otherwise. So the shift of the far field
between two pictures is the car's yaw, independent of the recorded steering.
"""

from __future__ import annotations

from typing import Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from recorder.errors import LogError
from recorder.mcap.message_index import UNCOMPRESSED
from recorder.mcap.picture_places import Pictures
from recorder.pictures.picture_size import decode_picture, scaled_to_width, width_and_height
from recorder.rows.row_quality import States, Values
from recorder.topics import camera_topic

WIDTH_PX: Final = 160
_APART_S: Final = 0.095  # between two pictures; in less time, the far field moves by a fraction of a pixel
_FARTHEST_S: Final = 0.3  # after a longer time, it has left the picture
_FAR: Final = (0.34, 0.5)  # shares of the height, around the horizon and above the near road
_SLOWEST_MPH: Final = 5.0
_PARTS: Final = 10  # samples of a long session, evenly spread

Picture = NDArray[np.float32]


def rows_apart(states: States, time_s: Values, most: int | None = None) -> NDArray[np.int64]:
    """Pairs (N, 2) of row positions of the moving car, far enough apart that their pictures show a turn.

    `time_s`: the rows' times, from `elapsed_s`. Of more than `most` rows, ten evenly spread parts with `most` rows
    together are used.
    """
    later = np.searchsorted(time_s, time_s + _APART_S).tolist()
    chain, position = list[int](), 0
    while position < len(later):
        chain.append(position)
        position = max(later[position], position + 1)
    rows = np.array(chain, np.int64)
    if most is not None and len(rows) > most:
        part_rows = most // _PARTS
        starts = np.linspace(0, len(rows) - part_rows, _PARTS).astype(np.int64)
        taken = (starts[:, None] + np.arange(part_rows)).ravel()
        pairs = np.stack([rows[taken[:-1]], rows[taken[1:]]], axis=1)[np.diff(taken) == 1]
    else:
        pairs = np.stack([rows[:-1], rows[1:]], axis=1)
    is_near = np.diff(time_s[pairs])[:, 0] <= _FARTHEST_S
    is_slow = (states.speed_mph[pairs] < _SLOWEST_MPH).any(axis=1)  # False for an unknown speed
    chosen: NDArray[np.int64] = pairs[is_near & ~is_slow]
    return chosen


class PictureLog(Protocol):
    """A source of pictures: a `Log`, or a log while it is written."""

    def pictures(self, topic: str) -> Pictures: ...

    def read(self, offset: int, length: int, chunk: int = UNCOMPRESSED) -> bytes: ...


class CenterPictures:
    """The centre camera's pictures, by the positions of their rows."""

    def __init__(self, log: PictureLog, states: States) -> None:
        self._log = log
        stored = log.pictures(camera_topic("center"))
        places = zip(*(column.tolist() for column in (stored.offset, stored.length, stored.chunk)), strict=True)
        moments = zip(stored.sequence.tolist(), stored.log_time_ns.tolist(), strict=True)
        by_moment = dict(zip(moments, places, strict=True))
        rows = zip(states.row.tolist(), states.time_ns.tolist(), strict=True)
        self._places = [by_moment.get(moment) for moment in rows]
        self.decoded_rows = set[int]()

    def gray(self, row: int) -> NDArray[np.uint8] | None:
        """The picture, at half its size if it has 320 columns or more; None if there is none, or it does not
        decode."""
        place = self._places[row]
        if place is None:
            return None
        try:
            encoded = self._log.read(*place)
            width_px, _ = width_and_height(encoded) or (0, 0)
            is_wide = width_px >= 2 * WIDTH_PX  # half of a small picture shows hardly any turn
            flags = cv2.IMREAD_REDUCED_GRAYSCALE_2 if is_wide else cv2.IMREAD_GRAYSCALE
            picture = decode_picture(encoded, flags)
        except LogError:
            return None
        if picture is not None:
            self.decoded_rows.add(row)
        return picture


class FarField:
    def __init__(self, log: PictureLog, states: States) -> None:
        self.pictures = CenterPictures(log, states)
        self._last: tuple[int, Picture | None] = (-1, None)

    def yaw_px(self, first: int, second: int) -> float:
        """The car's turn to the right between two rows, in columns of the picture; NaN if it is unknown."""
        before, after = (self._edges(row) for row in (first, second))
        if before is None or after is None or before.shape != after.shape:
            return float("nan")
        window = cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F)
        (shift_px, _), _ = cv2.phaseCorrelate(before, after, window)
        return -shift_px  # the world moves to the left

    def _edges(self, row: int) -> Picture | None:
        if self._last[0] != row:
            self._last = row, self._decoded(row)
        return self._last[1]

    def _decoded(self, row: int) -> Picture | None:
        """Vertical edges around the horizon; None if the picture is too flat or too narrow."""
        picture = self.pictures.gray(row)
        if picture is None:
            return None
        top, bottom = (round(share * picture.shape[0]) for share in _FAR)
        far = scaled_to_width(picture[top : max(bottom, top + 1)], WIDTH_PX)
        if far is None:
            return None
        return cv2.Sobel(cv2.GaussianBlur(far, (3, 3), 0), cv2.CV_32F, 1, 0).astype(np.float32, copy=False)
