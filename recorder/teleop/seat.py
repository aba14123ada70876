"""The seat: the page that holds the wheel, its controls in force, and its messages. These are untrusted: each is
checked completely."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Final

import msgspec

from recorder.topics import Device

MAX_MESSAGE_BYTES: Final = 4096
MAX_HOLD_MPH: Final = 200.0
MAX_BAD_S: Final = 60.0

_Share = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]
_Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]


class _Message(msgspec.Struct, tag_field="type"): ...


class ControlMessage(_Message, tag="control"):
    """The controls at a moment of the browser's clock."""

    number: _Count
    time_ms: Annotated[float, msgspec.Meta(ge=0.0, le=1e15)]
    steering: _Share  # -1 (left) .. 1 (right)
    throttle: _Share  # below 0 brakes
    device: Device
    touching: bool  # a key, stick, button or finger is in use
    hold_mph: Annotated[float, msgspec.Meta(ge=0.0, le=MAX_HOLD_MPH)] | None = None


class RecordMessage(_Message, tag="record"): ...


class PauseMessage(_Message, tag="pause"): ...


class BadMessage(_Message, tag="bad"):
    """The last seconds were driven badly."""

    seconds: Annotated[float, msgspec.Meta(gt=0.0, le=MAX_BAD_S)] = 5.0


class HandBackMessage(_Message, tag="hand_back"): ...


class PutBackMessage(_Message, tag="put_back"): ...


class EndMessage(_Message, tag="end"): ...


class ViewMessage(_Message, tag="view"):
    """The page's choice of picture: the recorded one, or the large one."""

    recorded: bool


class AskMessage(_Message, tag="ask"):
    """A page that watches asks for the wheel."""


class GiveMessage(_Message, tag="give"):
    """The page that holds the wheel gives it to the page that asked."""


class GotMessage(_Message, tag="got"):
    """A frame is on the screen: the next one may be sent."""

    frame: _Count


RequestMessage = RecordMessage | PauseMessage | BadMessage | HandBackMessage | PutBackMessage | EndMessage
"""Requests to the driving loop."""

Message = ControlMessage | RequestMessage | ViewMessage | AskMessage | GiveMessage | GotMessage

_DECODER: Final = msgspec.json.Decoder(Message)


def parse_message(text: str | bytes) -> Message | None:
    """A page's message; None for anything else."""
    try:
        return _DECODER.decode(text) if isinstance(text, str) else None
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None


ABSENT_S: Final = 1.0  # after this silence of the page, its person is absent: the car is braked
GIVES_UP_S: Final = 5.0  # after this silence, a page loses the wheel to the next page that asks


@dataclass(frozen=True)
class Control:
    """The person's controls at a moment."""

    steering: float = 0.0  # -1 (left) .. 1 (right)
    throttle: float = 0.0  # -1 .. 1; below 0 brakes
    hold_mph: float | None = None  # the speed to hold, instead of the throttle
    device: Device | None = None
    is_touching: bool = False  # a key, stick, button or finger is in use, or was since the loop looked last
    number: int = 0  # of the page's message; 0 before the first
    time_ms: float = 0.0  # the browser's clock at that message
    is_absent: bool = True  # nobody is at the wheel: brake the car


class Seat:
    """Times are seconds of a monotonic clock. Pages may be any objects. Not thread-safe."""

    def __init__(self) -> None:
        self.holder: object | None = None
        self.asking: object | None = None  # the page that asked for the wheel while another page holds it
        self._control = Control()
        self._last_s = float("-inf")  # the holder's last message
        self._was_touched = False  # since the loop looked last, so that short presses count
        self._is_touching = False  # by the holder's last message
        self._waits_for_touch = False  # until then, the controls are neutral

    def enter(self, page: object, now_s: float) -> None:
        """A page connects. It gets the wheel if no other page holds it."""
        if self.holder is None:
            self._seat(page, now_s)

    def leave(self, page: object, now_s: float) -> None:
        """A page disconnects. Its controls end at once."""
        if page is self.asking:
            self.asking = None
        if page is self.holder:
            self.holder = None
            self._let_go()
            self._last_s = now_s
            if self.asking is not None:
                self._seat(self.asking, now_s)

    def steer(self, page: object, message: ControlMessage, now_s: float) -> bool:
        """Put a page's controls in force; False if it does not hold the wheel, or sent later controls before."""
        if page is not self.holder:
            return False
        self._last_s = now_s
        if message.number <= self._control.number:
            return False
        self._waits_for_touch &= self._is_touching or not message.touching
        self._is_touching = message.touching
        self._control = Control(
            message.steering,
            message.throttle,
            message.hold_mph,
            message.device,
            message.touching,
            message.number,
            message.time_ms,
            is_absent=False,
        )
        self._was_touched |= message.touching
        if self._waits_for_touch:
            self._let_go()
        return True

    def wait_for_touch(self) -> None:
        """The car is another one now: the controls are neutral until the holder touches anew."""
        self._waits_for_touch = True
        self._let_go()

    def ask(self, page: object, now_s: float) -> None:
        """A page asks for the wheel. It gets it at once if no page holds it, or the holder is silent."""
        if page is self.holder:
            return
        if self.holder is None or now_s - self._last_s >= GIVES_UP_S:
            self._seat(page, now_s)
        else:
            self.asking = page

    def give(self, page: object, now_s: float) -> None:
        """The holder gives the wheel to the page that asked."""
        if page is self.holder and self.asking is not None:
            self._seat(self.asking, now_s)

    def control(self, now_s: float) -> Control:
        """The controls in force."""
        was_touched, self._was_touched = self._was_touched, False
        if now_s - self._last_s < ABSENT_S:
            return replace(self._control, is_touching=True) if was_touched else self._control
        return replace(self._control, steering=0.0, throttle=0.0, hold_mph=None, is_touching=False, is_absent=True)

    def _seat(self, page: object, now_s: float) -> None:
        self.holder = page
        if self.asking is page:
            self.asking = None
        self._let_go()
        self._is_touching = self._waits_for_touch = False
        self._control = replace(self._control, number=0)
        self._last_s = now_s

    def _let_go(self) -> None:
        self._was_touched = False
        self._control = replace(self._control, steering=0.0, throttle=0.0, hold_mph=None, is_touching=False)
