"""The messages from a page to the driving process. They are untrusted: each is checked completely."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from recorder.rows.devices import Device

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
