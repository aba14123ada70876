"""The instruments below the pictures of a video: steering wheel, speed, pedals, clock, and driver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import MAX_STEERING_DEG
from common.steering_unit import assumed_deg, steering_unit

Image = NDArray[np.uint8]
Color = tuple[int, int, int]  # BGR
Driver = Literal["network", "human", "expert"]

WHEEL_DEG: Final = 90.0  # the angle of the wheel on the panel for steering 1
WHEEL_X, WHEEL_Y, WHEEL_RADIUS = 84.0, 82.0, 52.0  # the position of the wheel on a panel of 640 x 160
# colours of the viewer's curves
RECORDED: Final[Color] = (255, 160, 120)
PREDICTED: Final[Color] = (60, 160, 255)

_WIDTH, _HEIGHT = 640, 160  # the panel size of all coordinates in this file
_SHIFT: Final = 4  # fractional bits of OpenCV's coordinates
_BACKGROUND: Final[Color] = (34, 30, 28)
_EDGE: Final[Color] = (58, 52, 48)
_TRACK: Final[Color] = (66, 60, 56)
_RIM: Final[Color] = (176, 170, 166)
_DIM: Final[Color] = (150, 144, 140)
_BRIGHT: Final[Color] = (240, 238, 236)
_GREEN: Final[Color] = (110, 210, 110)
_RED: Final[Color] = (90, 90, 230)

_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_BAR_LEFT, _BAR_RIGHT = 276.0, 444.0
_MAX_MPH: Final = 999.0  # the largest number that fits
_SPEED_Y, _THROTTLE_Y, _BRAKE_Y = 80.0, 104.0, 128.0
_DRIVER_COLORS: Final[dict[Driver, Color]] = {"network": PREDICTED, "expert": _GREEN, "human": RECORDED}


@dataclass(frozen=True)
class Reading:
    """The values of the instruments at one moment; NaN leaves an instrument empty."""

    time_s: float  # since the log began
    steering: float = math.nan  # as driven, -1 (left) .. 1 (right)
    predicted_steering: float = math.nan
    throttle: float = math.nan  # 0 .. 1
    brake: float = math.nan  # 0 .. 1
    speed_mph: float = math.nan
    set_speed_mph: float = math.nan
    driver: Driver | None = None
    autonomy_percent: float = math.nan


class Panel:
    """Draws readings on panels of one width. The height is a quarter of it."""

    def __init__(self, width: int, top_mph: float, max_steering_deg: float | None = MAX_STEERING_DEG) -> None:
        """`top_mph` is the end of the speed bar, `max_steering_deg` the wheels' angle at steering 1."""
        self._unit = steering_unit(max_steering_deg)
        self._full = self._unit.of(assumed_deg(max_steering_deg))
        self.width, self.height = width, max(2, width * _HEIGHT // _WIDTH // 2 * 2)
        self._top_mph = top_mph
        self._scale = width / _WIDTH
        self._canvas = np.empty((self.height, width, 3), np.uint8)
        self._empty = self._drawn_empty()

    def draw(self, reading: Reading) -> Image:
        """The panel (height, width, 3) BGR. The next call overwrites it."""
        np.copyto(self._canvas, self._empty)
        self._draw_steering(reading)
        self._draw_speed(reading)
        self._fill(_THROTTLE_Y, reading.throttle, _GREEN)
        self._fill(_BRAKE_Y, reading.brake, _RED)
        self._draw_text(reading)
        return self._canvas

    def _drawn_empty(self) -> Image:
        self._canvas[:] = _BACKGROUND
        self._line((0, 0), (_WIDTH, 0), _EDGE, 2)
        for label, y in (("speed", _SPEED_Y), ("throttle", _THROTTLE_Y), ("brake", _BRAKE_Y)):
            self._text(label, 184, y + 5, 15, _DIM)
            self._line((_BAR_LEFT, y), (_BAR_RIGHT, y), _TRACK, 8)
        return self._canvas.copy()

    def _draw_steering(self, reading: Reading) -> None:
        is_known = math.isfinite(reading.steering)
        turned_deg = WHEEL_DEG * _clamped(reading.steering) if is_known else 0.0
        self._draw_wheel(turned_deg, _RIM if is_known else _TRACK)
        if is_known:
            self._arc(turned_deg, RECORDED)
        if math.isfinite(reading.predicted_steering):
            self._pointer(WHEEL_DEG * _clamped(reading.predicted_steering), PREDICTED)

    def _draw_wheel(self, turned_deg: float, color: Color) -> None:
        self._line(_on_wheel(0, WHEEL_RADIUS + 8), _on_wheel(0, WHEEL_RADIUS + 12), _DIM, 2)
        for spoke_deg in (-90, 90, 180):
            ends = _on_wheel(turned_deg + spoke_deg, 10), _on_wheel(turned_deg + spoke_deg, 48)
            self._line(*ends, color, 9)
        self._wheel_circle(WHEEL_RADIUS, color, 9)
        self._wheel_circle(15, color, -1)

    def _arc(self, turned_deg: float, color: Color) -> None:
        points = [_on_wheel(turned_deg + part_deg, WHEEL_RADIUS) for part_deg in range(-10, 11, 2)]
        cv2.polylines(self._canvas, [self._points(points)], False, color, self._thickness(9), cv2.LINE_AA, _SHIFT)

    def _pointer(self, turned_deg: float, color: Color) -> None:
        corners = [
            _on_wheel(turned_deg, WHEEL_RADIUS + 6),
            _on_wheel(turned_deg - 6, WHEEL_RADIUS + 18),
            _on_wheel(turned_deg + 6, WHEEL_RADIUS + 18),
        ]
        cv2.fillPoly(self._canvas, [self._points(corners)], color, cv2.LINE_AA, _SHIFT)

    def _draw_speed(self, reading: Reading) -> None:
        self._fill(_SPEED_Y, reading.speed_mph / self._top_mph, _BRIGHT)
        if math.isfinite(reading.set_speed_mph):
            at = _BAR_LEFT + (_BAR_RIGHT - _BAR_LEFT) * min(max(reading.set_speed_mph / self._top_mph, 0), 1)
            self._line((at, _SPEED_Y - 8), (at, _SPEED_Y + 8), PREDICTED, 2)

    def _fill(self, y: float, share: float, color: Color) -> None:
        share = min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
        if share > 0:
            self._line((_BAR_LEFT, y), (_BAR_LEFT + (_BAR_RIGHT - _BAR_LEFT) * share, y), color, 8)

    def _draw_text(self, reading: Reading) -> None:
        right = _WIDTH - 18
        self._text(clock(reading.time_s), right, 50, 24, _BRIGHT, is_right=True)
        if math.isfinite(reading.speed_mph):
            end = self._text(f"{min(reading.speed_mph, _MAX_MPH):.1f}", 184, 50, 38, _BRIGHT)
            self._text("mph", end + 6, 50, 15, _DIM)
        if math.isfinite(reading.autonomy_percent):
            self._text(f"autonomy {reading.autonomy_percent:.0f} %", _BAR_RIGHT + 4, 50, 15, _DIM, is_right=True)
        if reading.driver is not None:
            self._text(f"{reading.driver} drives", right, 85, 15, _DRIVER_COLORS[reading.driver], is_right=True)
        for word, steering, y, color in (
            ("steered", reading.steering, 109, RECORDED),
            ("network", reading.predicted_steering, 133, PREDICTED),
        ):
            if math.isfinite(steering):
                text = f"{word} {self._full * _clamped(steering):+z.1f} {self._unit.short}"
                self._text(text, right, y, 15, color, is_right=True)

    def _text(
        self, text: str, x: float, y: float, height: float, color: Color, *, is_right: bool = False
    ) -> float:
        """Write text from `x`, or with `is_right` up to `x`. Returns the right end of the text. `height` is the
        height of a line."""
        size, thickness = height * self._scale / 30, self._thickness(1)
        width = cv2.getTextSize(text, _FONT, size, thickness)[0][0] / self._scale
        left = x - width if is_right else x
        at = (round(left * self._scale), round(y * self._scale))
        cv2.putText(self._canvas, text, at, _FONT, size, color, thickness, cv2.LINE_AA)
        return left + width

    def _line(self, start: tuple[float, float], end: tuple[float, float], color: Color, width: float) -> None:
        first, last = self._points([start, end]).tolist()
        cv2.line(self._canvas, first, last, color, self._thickness(width), cv2.LINE_AA, _SHIFT)

    def _wheel_circle(self, radius: float, color: Color, width: float) -> None:
        (at,) = self._points([(WHEEL_X, WHEEL_Y)]).tolist()
        thickness = self._thickness(width) if width > 0 else -1
        fixed = round(radius * self._scale * (1 << _SHIFT))
        cv2.circle(self._canvas, at, fixed, color, thickness, cv2.LINE_AA, _SHIFT)

    def _points(self, points: list[tuple[float, float]]) -> NDArray[np.int32]:
        return np.rint(np.array(points) * self._scale * (1 << _SHIFT)).astype(np.int32)

    def _thickness(self, width: float) -> int:
        return max(1, round(width * self._scale))


def clock(time_s: float) -> str:
    """The time as text: 0:07.5, 12:03.4 or 1:02:03.4."""
    tenths = round(time_s * 10)
    minutes, tenths = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    seconds = f"{tenths // 10:02d}.{tenths % 10}"
    return f"{hours}:{minutes:02d}:{seconds}" if hours else f"{minutes}:{seconds}"


def _clamped(steering: float) -> float:
    return min(max(steering, -1.0), 1.0)


def _on_wheel(turned_deg: float, radius: float) -> tuple[float, float]:
    """The point on the panel at `turned_deg` degrees clockwise from the wheel's top."""
    angle = math.radians(turned_deg)
    return WHEEL_X + radius * math.sin(angle), WHEEL_Y - radius * math.cos(angle)
