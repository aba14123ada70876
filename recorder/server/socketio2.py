"""Clients of Socket.IO 2, such as the real simulator, beside modern ones on the same port.

Such a client sends no CONNECT packet, so that python-socketio 5 silently drops all of its events. The packet is
supplied per connection; nothing is patched. (`engineio_connection` answers the heartbeats that it sends itself.)
"""

from __future__ import annotations

from typing import Any

import socketio

CONNECT, EVENT = "0", "2"  # Socket.IO packet types, the first character of an Engine.IO message


def accept_socketio2_clients(server: socketio.Server) -> None:
    """Make `server` serve them. Call it before the server runs, after its own handlers are set up."""
    engine = server.eio
    connected, received, left = (engine.handlers[name] for name in ("connect", "message", "disconnect"))
    unannounced: set[str] = set()

    def on_connect(sid: str, environ: dict[str, Any]) -> Any:
        unannounced.add(sid)
        return connected(sid, environ)

    def on_message(sid: str, data: str | bytes) -> None:
        if sid in unannounced:
            unannounced.discard(sid)
            if isinstance(data, str) and data.startswith(EVENT):
                received(sid, CONNECT)  # a modern client's first message is this one
        received(sid, data)

    def on_disconnect(sid: str, reason: str) -> None:
        unannounced.discard(sid)
        left(sid, reason)

    engine.on("connect", on_connect)
    engine.on("message", on_message)
    engine.on("disconnect", on_disconnect)
