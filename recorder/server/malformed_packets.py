"""Decodes Socket.IO packets strictly, and shows python-socketio's tracebacks as one line.

Clients may send anything, and a broken client must not fill the screen of a drive.
"""

from __future__ import annotations

import logging
import re
from typing import Any, Final

from socketio import packet

from common.car import CAMERAS
from recorder.server.connection_guard import Notify
from recorder.server.telemetry import NOT_JSON

MAX_ATTACHMENTS: Final = len(CAMERAS)  # a packet is kept until they have come: a picture of each camera
MAX_NAMESPACE_CHARACTERS: Final = 100

NOTICE_MALFORMED: Final = (
    "a client was refused ({}): it needs python-socketio 5, or Socket.IO 3 or newer, at this address"
)

# python-socketio's own; a client may not send them
_RESERVED_EVENTS = ("connect", "disconnect")
_TELEMETRY = re.compile(r'(?:2|5(?:(\d{1,9})-)?)\d*\[\s*"telemetry"')  # the group: number of attachments


def is_telemetry(message: str | bytes) -> bool:
    """True for an Engine.IO message that holds a telemetry, valid or not."""
    return isinstance(message, str) and message[:1] == "4" and _TELEMETRY.match(message, 1) is not None


class CheckedPacket(packet.Packet):  # type: ignore[misc]
    """A packet that is decoded strictly: an event needs a name that a client may use. A telemetry is always
    accepted, whatever it holds, because it must be answered."""

    def decode(self, encoded_packet: Any) -> Any:
        try:
            attachments = super().decode(encoded_packet)
        except (ValueError, RecursionError):  # not JSON, or too deep
            telemetry = _TELEMETRY.match(encoded_packet) if isinstance(encoded_packet, str) else None
            if telemetry is None:
                raise
            attachments = int(telemetry[1] or 0)  # they still come
            self.packet_type = packet.BINARY_EVENT if attachments else packet.EVENT
            self.namespace, self.data = None, ["telemetry", NOT_JSON]
        if len(self.namespace or "") > MAX_NAMESPACE_CHARACTERS:  # the error answer would repeat it
            raise ValueError("no namespace has such a name")
        if attachments is not None and attachments > MAX_ATTACHMENTS:
            raise ValueError("too many attachments")
        if self.packet_type in (packet.EVENT, packet.BINARY_EVENT):
            data = self.data
            if not (isinstance(data, list) and data and isinstance(data[0], str)) or data[0] in _RESERVED_EVENTS:
                raise ValueError("not an event of a client")
            if not attachments:  # python-socketio would wait for one
                self.packet_type = packet.EVENT
        return attachments

    def add_attachment(self, attachment: Any) -> Any:
        event = self.data
        try:
            return super().add_attachment(attachment)
        except (ValueError, TypeError, LookupError, RecursionError):  # it has no place, or one that is too deep
            if not (isinstance(event, list) and event[0] == "telemetry"):
                raise
            self.data = ["telemetry", NOT_JSON]
            return True


def check_body(environ: dict[str, Any]) -> None:
    """Raises ValueError for a body of unknown length: it may never end."""
    length = environ.get("CONTENT_LENGTH") or "0"
    if environ.get("HTTP_TRANSFER_ENCODING") or not (length.isascii() and length.isdecimal()):
        raise ValueError("a body without a length")


def one_line_logger(notify: Notify) -> logging.Logger:
    """A logger for python-socketio that passes each error to `notify` as a printable line."""
    log = logging.Logger("telemetry", logging.ERROR)
    log.addHandler(_NoticeHandler(notify))
    return log


class _NoticeHandler(logging.Handler):
    def __init__(self, notify: Notify) -> None:
        super().__init__()
        self._notify = notify

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().partition(" (further occurrences")[0]
        self._notify(NOTICE_MALFORMED.format("".join(c if c.isprintable() else "?" for c in text[:200])))
