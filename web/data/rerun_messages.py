"""The proxy between Rerun's viewer and the process that serves its log: gRPC-Web, over HTTP/1.1.

So a viewer asks bc-web only. Across `ssh -L` and with `--host` it needs no port but the page's own, and what
guards the page guards the log's data, too.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Final

import anyio
import h11
from anyio.abc import SocketStream

from web.errors import WebError

METHOD: Final = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
"""The method that a viewer calls. Its response is the log and, while that is being recorded, its growth."""

_LOCAL: Final = "127.0.0.1"
_PASSED_ON: Final = ("content-type", "accept", "x-grpc-web")
_AT_ONCE: Final = 1 << 18  # bytes


@dataclass(frozen=True)
class Messages:
    """Rerun's answer, as it comes."""

    status: int
    media_type: str
    body: AsyncIterator[bytes]


async def ask_for_messages(port: int, headers: Mapping[str, str], body: bytes) -> Messages:
    """Ask the process that serves a log on `port`. Raises WebError if it does not answer."""
    connection = h11.Connection(h11.CLIENT)
    passed_on = [(name, headers[name]) for name in _PASSED_ON if name in headers]
    request = h11.Request(
        method="POST",
        target=METHOD,
        headers=[("host", f"{_LOCAL}:{port}"), ("content-length", str(len(body))), *passed_on],
    )
    try:
        stream = await anyio.connect_tcp(_LOCAL, port)
        try:
            for event in (request, h11.Data(body), h11.EndOfMessage()):
                await stream.send(connection.send(event) or b"")
            head = await _next_event(connection, stream)
            if not isinstance(head, h11.Response):
                raise h11.RemoteProtocolError("no answer")
        except BaseException:
            await anyio.aclose_forcefully(stream)
            raise
    except (OSError, anyio.BrokenResourceError, h11.RemoteProtocolError):
        raise WebError("Rerun does not answer; open the log again", 503) from None
    kind = dict(head.headers).get(b"content-type", b"application/grpc-web+proto")
    return Messages(head.status_code, kind.decode("latin-1"), _body(connection, stream))


async def _body(connection: h11.Connection, stream: SocketStream) -> AsyncIterator[bytes]:
    """The body of Rerun's response, to its end or that of the process, which `open_log` reports to the page."""
    async with stream:
        with contextlib.suppress(OSError, anyio.BrokenResourceError, h11.RemoteProtocolError):
            while isinstance(event := await _next_event(connection, stream), h11.Data):
                yield bytes(event.data)


async def _next_event(connection: h11.Connection, stream: SocketStream) -> object:
    """The next event of h11, once enough of it has come."""
    while (event := connection.next_event()) is h11.NEED_DATA:
        try:
            data = await stream.receive(_AT_ONCE)
        except anyio.EndOfStream:
            data = b""
        connection.receive_data(data)
    return event
