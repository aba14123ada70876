"""Pictures of a drive for a person's eyes: larger than the recorded ones as far as the processor has room."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass, replace
from typing import Final, Self

from common.interrupts import leave_signals_to_main_thread
from recorder.teleop.frame_state import FrameState
from recorder.teleop.rate_meter import RateMeter
from recorder.teleop.wheel import Wheel
from simulator.driving.simulation import Simulation
from simulator.driving.vehicle import STEP_S
from simulator.pose import Pose

EYE_STEPS: Final = 2  # steps of the simulator from one picture to the next
EYE_HZ: Final = 1 / (EYE_STEPS * STEP_S)
MAX_STEPS_BEHIND: Final = 4  # so many steps the clock goes on without a new picture; then it waits for one
SCALES: Final = (1.0, 1.5, 2.0)  # sizes, by that of recorded pictures: 320x160, 480x240, 640x320
_FULL_SHARE: Final = 0.9  # of the time between two pictures; rendering that takes more is too slow
_ROOM_SHARE: Final = 0.5  # rendering at the next larger size that would take less has room
_TRIAL: Final = 10  # of so many pictures as small as the recorded ones, one is rendered to see if there is room
_MIN_SLOW, _MIN_FAST = 5, 50  # pictures of a size before the next smaller, or larger, one is tried


@dataclass(frozen=True)
class EyeMoment:
    """A moment of a drive to be shown."""

    step: int
    pose: Pose
    state: FrameState
    recorded: bytes | None = None  # the picture as it is recorded, if it is there already


class PictureScale:
    """The largest size at which pictures keep up, by how long the last ones took."""

    def __init__(self) -> None:
        self._at = len(SCALES) - 1
        self._mean_s: float | None = None
        self._pictures = 0
        self._small = 0

    @property
    def scale(self) -> float:
        return SCALES[self._at]

    def is_recorded_enough(self) -> bool:
        """True if the recorded picture, where it is there, serves in place of the next one."""
        self._small = 0 if self._at else self._small + 1
        return self._small % _TRIAL != 0

    def note(self, seconds: float) -> None:
        """Note how long a picture of this size took."""
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
    """The steps whose moments are shown: every `EYE_STEPS`, and at once the first that steers another way."""

    def __init__(self) -> None:
        self._step = -EYE_STEPS
        self._steering = 0.0
        self._side = 0.0  # to which the steering went lately; 0: it stayed

    def is_due(self, step: int, steering: float) -> bool:
        turned = steering - self._steering
        side = math.copysign(1.0, turned) if turned else 0.0
        is_new_way = side not in (0.0, self._side)
        if step - self._step < EYE_STEPS and not is_new_way:
            return False
        self._step, self._steering, self._side = step, steering, side
        return True


class EyePictures:
    """Renders the newest moment on a thread, and shows it on the pages of a wheel."""

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
        """Show a moment, in place of one that still waits; without a page, nothing."""
        if self._failure is not None:
            raise self._failure
        if self._wheel.pages:
            with self._changed:
                self._next = moment
                self._changed.notify_all()

    def let_pass(self, patience_s: float) -> None:
        """Wait until no picture is being rendered, for so long at most."""
        with self._changed:
            self._changed.wait_for(lambda: self._rendering is None and self._next is None, patience_s)

    def keeps_up(self, step: int, patience_s: float) -> bool:
        """True if the picture that is being rendered is of one of the last steps; waits for that so long."""
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
        leave_signals_to_main_thread()
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
