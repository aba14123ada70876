"""What is not Socket.IO: whoever sends it is hung up on, and python-socketio's tracebacks become one line.

Anybody who reaches the port can send anything, and a broken client must not fill the screen of a drive.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any

import socketio
from socketio import packet

BROKEN_PACKET = "broken packet"
MOST_ATTACHMENTS = 8  # they are kept until the last has come
_OURS = ("connect", "disconnect")  # events that python-socketio raises itself; none of a client's business

Application = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]


class CheckedPacket(packet.Packet):  # type: ignore[misc]
    """A packet that is an event only if it has a name that a client may give."""

    def decode(self, encoded_packet: Any) -> Any:
        attachments = super().decode(encoded_packet)
        if attachments is not None and attachments > MOST_ATTACHMENTS:
            raise ValueError("too many attachments")
        if self.packet_type in (packet.EVENT, packet.BINARY_EVENT):
            data = self.data
            if not (isinstance(data, list) and data and isinstance(data[0], str)) or data[0] in _OURS:
                raise ValueError("not an event of a client")
        return attachments


def hang_up_on_broken_packets(server: socketio.Server) -> Application:
    """The web application of `server`, which closes the connections that break the protocol.

    Call it last, before the server runs.
    """
    engine = server.eio
    connected, received = engine.handlers["connect"], engine.handlers["message"]
    application = socketio.WSGIApp(server)

    def hang_up(sid: str | None) -> None:
        connection = engine.sockets.get(sid)
        if connection is not None:
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
            answer: Iterable[bytes] = application(environ, start_response)
        except Exception:  # what is not even Engine.IO
            hang_up(environ.get("telemetry.sid"))
            raise
        return answer

    engine.on("connect", on_connect)
    engine.on("message", on_message)
    return serve


def one_line_log() -> logging.Logger:
    """A logger for python-socketio that writes errors to stderr, a line each, whatever a client put into them."""
    handler = logging.StreamHandler()
    handler.setFormatter(_OneLine())
    log = logging.Logger("telemetry", logging.ERROR)
    log.addHandler(handler)
    return log


class _OneLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        error = record.exc_info[1] if record.exc_info else None
        text = record.getMessage() + (f": {type(error).__name__}: {error}" if error else "")
        return "".join(character if character.isprintable() else "?" for character in text[:500])
