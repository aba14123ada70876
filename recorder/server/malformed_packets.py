"""What is not Socket.IO: whoever sends it is hung up on, and python-socketio's tracebacks become one line.

Anybody who reaches the port can send anything, and a broken client must not fill the screen of a drive.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable
from typing import Any, Final

import socketio
from socketio import packet

from recorder.server.connection_guard import Said, page

BROKEN_PACKET: Final = "broken packet"
MOST_ATTACHMENTS: Final = 1  # kept until it has come: a telemetry has one picture
MOST_NAMESPACE: Final = 100  # characters
NOT_JSON: Final = "not JSON"
"""What the handler gets for a telemetry that cannot be read at all: it is answered like any other."""

BROKEN: Final = (
    "hung up on a client that broke the Socket.IO protocol: a simulator in autonomous mode does not, other clients"
    " need python-socketio 5 or its like"
)
REFUSED: Final = "a client was refused ({}): it needs python-socketio 5, or Socket.IO 3 or newer, at this address"

_OURS = ("connect", "disconnect")  # events that python-socketio raises itself; none of a client's business
_TELEMETRY = re.compile(r'(?:2|5(?:(\d{1,9})-)?)\d*\[\s*"telemetry"')  # and its attachments

Application = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]


class CheckedPacket(packet.Packet):  # type: ignore[misc]
    """A packet that is an event only if it has a name that a client may give. A telemetry always is one, whatever
    comes with it."""

    def decode(self, encoded_packet: Any) -> Any:
        try:
            attachments = super().decode(encoded_packet)
        except (ValueError, RecursionError):  # not JSON, or too deep
            telemetry = _TELEMETRY.match(encoded_packet) if isinstance(encoded_packet, str) else None
            if telemetry is None:
                raise
            attachments = int(telemetry[1] or 0)  # they come all the same
            self.packet_type = packet.BINARY_EVENT if attachments else packet.EVENT
            self.namespace, self.data = None, ["telemetry", NOT_JSON]
        if len(self.namespace or "") > MOST_NAMESPACE:  # it comes back, in the answer that there is none
            raise ValueError("no namespace has such a name")
        if attachments is not None and attachments > MOST_ATTACHMENTS:
            raise ValueError("too many attachments")
        if self.packet_type in (packet.EVENT, packet.BINARY_EVENT):
            data = self.data
            if not (isinstance(data, list) and data and isinstance(data[0], str)) or data[0] in _OURS:
                raise ValueError("not an event of a client")
            if not attachments:  # python-socketio would wait for the first of none
                self.packet_type = packet.EVENT
        return attachments

    def add_attachment(self, attachment: Any) -> Any:
        event = self.data
        try:
            return super().add_attachment(attachment)
        except (ValueError, TypeError, LookupError, RecursionError):  # its place is nowhere, or too deep
            if not (isinstance(event, list) and event[0] == "telemetry"):
                raise
            self.data = ["telemetry", NOT_JSON]
            return True


def hang_up_on_broken_packets(server: socketio.Server, said: Said) -> Application:
    """The web application of `server`, which closes the connections that break the protocol.

    Call it last, before the server runs.
    """
    engine = server.eio
    connected, received = engine.handlers["connect"], engine.handlers["message"]
    application = socketio.WSGIApp(server, page(said))

    def hang_up(sid: str | None) -> None:
        connection = engine.sockets.get(sid)
        if connection is not None and not connection.closed:
            said(BROKEN)
            connection.close(wait=False, reason=BROKEN_PACKET)

    def on_connect(sid: str, environ: dict[str, Any]) -> Any:
        environ["telemetry.sid"] = sid
        return connected(sid, environ)

    def on_message(sid: str, data: Any) -> None:
        try:
            received(sid, data)
        except Exception:  # its parser raises nearly anything; a handler's own errors never come here
            hang_up(sid)

    def serve(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        try:
            _check_body(environ)
            answer: Iterable[bytes] = application(environ, start_response)
        except Exception:  # what is not even Engine.IO
            hang_up(environ.get("telemetry.sid"))
            start_response("400 Bad Request", [("Content-Length", "0")])
            return []
        return answer

    engine.on("connect", on_connect)
    engine.on("message", on_message)
    return serve


def _check_body(environ: dict[str, Any]) -> None:
    """Raises ValueError for a body whose size is not known before it is read: it may have no end."""
    length = environ.get("CONTENT_LENGTH") or "0"
    if environ.get("HTTP_TRANSFER_ENCODING") or not (length.isascii() and length.isdecimal()):
        raise ValueError("a body without a length")


def one_line_log(said: Said) -> logging.Logger:
    """A logger for python-socketio that says its errors, a line each, whatever a client put into them."""
    log = logging.Logger("telemetry", logging.ERROR)
    log.addHandler(_Sayer(said))
    return log


class _Sayer(logging.Handler):
    def __init__(self, said: Said) -> None:
        super().__init__()
        self._said = said

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().partition(" (further occurrences")[0]
        self._said(REFUSED.format("".join(c if c.isprintable() else "?" for c in text[:200])))
