"""Pictures for the person who drives: larger than the recorded ones, if the processor is fast enough."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass, replace
from typing import Final, Self

from recorder.teleop.frame_state import FrameState, RateMeter
from recorder.teleop.wheel import Wheel
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import STEP_S
from simulator.pose import Pose

EYE_STEPS: Final = 2  # simulator steps from one picture to the next
EYE_HZ: Final = 1 / (EYE_STEPS * STEP_S)
MAX_STEPS_BEHIND: Final = 4  # steps without a new picture, before the clock waits for it
SCALES: Final = (1.0, 1.5, 2.0)  # sizes relative to recorded pictures: 320x160, 480x240, 640x320
_FULL_SHARE: Final = 0.9  # share of the time between two pictures; slower rendering needs a smaller size
_ROOM_SHARE: Final = 0.5  # a larger size is tried if its rendering would take a smaller share
_TRIAL: Final = 10  # at the smallest size, every tenth picture is rendered anew to measure the time
_MIN_SLOW, _MIN_FAST = 5, 50  # pictures of a size before a smaller, or a larger, one is tried


@dataclass(frozen=True)
class EyeMoment:
    step: int
    pose: Pose
    state: FrameState
    recorded: bytes | None = None  # the recorded picture, if it is rendered already


class PictureScale:
    """The largest size at which rendering keeps up, measured on the last pictures."""

    def __init__(self) -> None:
        self._at = len(SCALES) - 1
        self._mean_s: float | None = None
        self._pictures = 0
        self._small = 0

    @property
    def scale(self) -> float:
        return SCALES[self._at]

    def is_recorded_enough(self) -> bool:
        """True if the recorded picture, if there is one, can be shown as the next one."""
        self._small = 0 if self._at else self._small + 1
        return self._small % _TRIAL != 0

    def note(self, seconds: float) -> None:
        self._pictures += 1
        self._mean_s = seconds if self._mean_s is None else 0.9 * self._mean_s + 0.1 * seconds
        max_s = 1 / EYE_HZ
        larger = SCALES[min(self._at + 1, len(SCALES) - 1)]
        if self._pictures >= _MIN_SLOW and self._mean_s > _FULL_SHARE * max_s and self._at > 0:
            self._change(-1)
        elif self._pictures >= _MIN_FAST and self._mean_s * (larger / self.scale) ** 2 < _ROOM_SHARE * max_s:
            self._change(+1)

    def _change(self, by: int) -> None:
        self._at = min(self._at + by, len(SCALES) - 1)
        self._mean_s, self._pictures = None, 0


class WhenDue:
    """Chooses the steps to show: every `EYE_STEPS`, and at once a step that begins to steer another way."""

    def __init__(self) -> None:
        self._step = -EYE_STEPS
        self._steering = 0.0
        self._side = 0.0  # sign of the last change of the steering; 0: no change

    def is_due(self, step: int, steering: float) -> bool:
        turned = steering - self._steering
        side = math.copysign(1.0, turned) if turned else 0.0
        is_new_way = side not in (0.0, self._side)
        if step - self._step < EYE_STEPS and not is_new_way:
            return False
        self._step, self._steering, self._side = step, steering, side
        return True


class EyePictures:
    """Renders the newest moment in a thread, and shows it on the pages of a wheel."""

    def __init__(self, simulation: Simulation, wheel: Wheel) -> None:
        self._simulation = simulation
        self._wheel = wheel
        self._scale = PictureScale()
        self._changed = threading.Condition()
        self._next: EyeMoment | None = None
        self._rendering: EyeMoment | None = None
        self._is_over = False
        self._rates = RateMeter()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="eye", daemon=True)

    def offer(self, moment: EyeMoment) -> None:
        """Show a moment if there is a page. It replaces one that still waits."""
        if self._failure is not None:
            raise self._failure
        if self._wheel.pages:
            with self._changed:
                self._next = moment
                self._changed.notify_all()

    def let_pass(self, patience_s: float) -> None:
        """Wait until no picture is rendered, at most `patience_s`."""
        with self._changed:
            self._changed.wait_for(lambda: self._rendering is None and self._next is None, patience_s)

    def keeps_up(self, step: int, patience_s: float) -> bool:
        """True if the picture in rendering is of one of the last steps. Waits for that at most `patience_s`."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._rendering is None or step - self._rendering.step < MAX_STEPS_BEHIND, patience_s
            )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._rendering = None
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._is_over or self._next)
                if self._is_over or self._next is None:
                    return
                moment = self._rendering = self._next
                self._next = None
            try:
                self._show(moment)
            except Exception as error:
                self._failure = error

    def _show(self, moment: EyeMoment) -> None:
        begin_s = time.monotonic()
        if self._wheel.wants_recorded:
            jpeg = moment.recorded or self._simulation.jpeg("center", moment.pose)
        elif moment.recorded and self._scale.is_recorded_enough():
            jpeg = moment.recorded
        else:
            jpeg = self._simulation.jpeg("center", moment.pose, self._scale.scale)
            self._scale.note(time.monotonic() - begin_s)
        self._rates.add(time.monotonic())
        state = replace(moment.state, picture_hz=self._rates.frames_per_s)
        self._wheel.show(state.as_message(), jpeg)
