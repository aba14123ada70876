"""The web server, in a thread: the main thread waits for Ctrl-C."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable
from typing import Final

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send

from common import UserError
from recorder.errors import ListenError
from recorder.server.connection_guard import listen, send_at_once
from recorder.teleop.seat import MAX_MESSAGE_BYTES

_LAST_ANSWERS_S: Final = 2  # for requests in progress when the server stops
_TICK_S: Final = 0.2


class WorkbenchServer:
    """Serves an app. Its socket listens from the beginning, so that the port is known."""

    def __init__(self, app: ASGIApp, host: str, port: int) -> None:
        """Raises UserError if the server cannot listen on host:port."""
        try:
            self._socket: socket.socket = listen(host, port)
        except ListenError as error:
            reason = str(error).partition("; end the bc-drive")[0]
            raise UserError(f"{reason}; give another --port, or end the bc-web that is running there") from None
        # Head and body of an answer are two writes: without this, each answer waits 40 ms for a delayed
        # acknowledgement. asyncio sets it only for sockets made with the protocol's number. Connections inherit
        # it.
        send_at_once(self._socket)
        self.port: int = self._socket.getsockname()[1]
        self._app = app
        self._server = uvicorn.Server(
            uvicorn.Config(
                self._answer,
                interface="asgi3",
                lifespan="off",
                ws="websockets-sansio",
                ws_max_size=MAX_MESSAGE_BYTES,
                ws_per_message_deflate=False,  # the large messages are JPEGs
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=_LAST_ANSWERS_S,
            )
        )
        self._thread = threading.Thread(target=self._run, name="web server")

    def start(self) -> None:
        self._thread.start()

    def serve_until(self, is_stopped: Callable[[float], bool]) -> None:
        """Serve until `is_stopped`, which gets the seconds to wait, is true, or the server ends by itself."""
        while self._thread.is_alive() and not is_stopped(_TICK_S):
            pass

    def stop(self) -> None:
        """End the server. Requests in progress get a moment more."""
        self._server.should_exit = True
        logger = logging.getLogger("uvicorn.error")
        logger.disabled = True  # uvicorn reports each request that it cancels, with a traceback
        self._thread.join()
        logger.disabled = False
        self._socket.close()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope["is_ending"] = lambda: self._server.should_exit  # for long answers
        await self._app(scope, receive, send)

    def _run(self) -> None:
        self._server.run(sockets=[self._socket])
