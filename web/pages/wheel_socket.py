"""The socket of the page at the wheel. It forwards messages between the page and the process that drives."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Final

from starlette.concurrency import run_in_threadpool
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.frames import CloseCode

from web.errors import WebError
from web.jobs.wheels import running

_MAX_FRAME_BYTES: Final = 8 << 20
_PATIENCE_S: Final = 5.0
_QUEUE: Final = 2  # messages for a slow page; then the process waits


def wheel_socket_routes() -> list[WebSocketRoute]:
    async def socket(page: WebSocket) -> None:
        try:
            process = await _process(page.path_params["key"])
        except WebError:
            await page.close()
            return
        async with process:
            with contextlib.suppress(WebSocketDisconnect):
                await page.accept()
                await _carry(page, process)
            await process.close()
            code = process.close_code
            is_reason = code in (CloseCode.POLICY_VIOLATION, CloseCode.MESSAGE_TOO_BIG)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # the page has closed it
                await page.close(code if is_reason and code else CloseCode.NORMAL_CLOSURE)

    return [WebSocketRoute("/wheel/{key}/socket", socket)]


async def _process(key: str) -> ClientConnection:
    """A connection to the process that drives. Raises WebError if it has ended, or takes no more pages."""
    wheel = await run_in_threadpool(running, key)
    try:
        return await connect(
            f"ws://127.0.0.1:{wheel.port}",
            additional_headers={"Authorization": f"Bearer {wheel.token}"},
            compression=None,
            max_size=_MAX_FRAME_BYTES,
            max_queue=_QUEUE,
            proxy=None,
            open_timeout=_PATIENCE_S,
            close_timeout=1,
        )
    except (OSError, WebSocketException):
        raise WebError("the drive has ended, or takes no more pages", 503) from None


async def _carry(page: WebSocket, process: ClientConnection) -> None:
    """Forward messages until either side closes. Each side waits for the other, so that nothing piles up."""
    ways = [asyncio.create_task(_to_process(page, process)), asyncio.create_task(_to_page(page, process))]
    try:
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for way in ways:
            way.cancel()
        for result in await asyncio.gather(*ways, return_exceptions=True):
            if isinstance(result, Exception) and not isinstance(result, (ConnectionClosed, WebSocketDisconnect)):
                raise result


async def _to_process(page: WebSocket, process: ClientConnection) -> None:
    while (message := await page.receive())["type"] == "websocket.receive":
        text = message.get("text")
        await process.send(message["bytes"] if text is None else text)


async def _to_page(page: WebSocket, process: ClientConnection) -> None:
    async for data in process:
        if isinstance(data, str):
            await page.send_text(data)
        else:
            await page.send_bytes(data)
