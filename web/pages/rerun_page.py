"""A log in Rerun, inside the page of its session: the viewer in a frame, and the request that keeps it open."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from typing import Final

import anyio
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from common import UserError
from common.errors import printable
from web.errors import WebError
from web.folders.project_folders import Place, is_recording
from web.pages.workbench import Workbench
from web.processes.rerun_viewers import FILES, viewer_version
from web.server.templates import KEPT, page

_POLL_S: Final = 0.1
_POLICY: Final = "; ".join(  # the viewer is Rerun's program: it may reach only this server
    (
        "default-src 'none'",
        "script-src 'self' 'wasm-unsafe-eval'",
        "style-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self'",
        "base-uri 'none'",
        "frame-ancestors 'self'",
    )
)


def rerun_routes(bench: Workbench) -> list[Route]:
    """The frame that a viewer runs in, and the viewer's own files."""

    def frame(request: Request) -> Response:
        viewer = bench.viewers.get(request.path_params["key"])
        answer = page("rerun.html", recording=f"/rerun/{viewer.key}/log.rrd", rerun_version=viewer_version())
        answer.headers["Content-Security-Policy"] = _POLICY
        return answer

    def recording(request: Request) -> Response:
        """The log as a recording file. It grows while the log is read or recorded."""
        viewer = bench.viewers.get(request.path_params["key"])
        return StreamingResponse(viewer.recording(), media_type="application/octet-stream")

    def file(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in FILES:
            raise WebError(f"{name}: no file of Rerun's viewer", 404)
        is_kept = request.query_params.get("v") == viewer_version()
        headers = KEPT if is_kept else {}
        return Response(bench.viewers.file(name), media_type=FILES[name], headers=headers)

    return [
        Route("/rerun/{key}", frame),
        Route("/rerun/{key}/log.rrd", recording),
        Route("/rerun/files/{name}", file),
    ]


def rerun_log_routes(bench: Workbench, place: Place) -> list[Route]:
    def open_log(request: Request) -> Response:
        """Lines of JSON: the viewer's address once it can be opened, notes on the log, and why it was closed. The
        log is open as long as these lines are read."""
        path = bench.folders.log(place, request.path_params["log"])
        is_growing = is_recording(path)
        opened = bench.logs.open(path)
        first_ns = int(next(iter(opened.states.time_ns), 0))
        late_s = 1e-9 * (first_ns - opened.log.time_range_ns[0])

        async def lines() -> AsyncIterator[str]:
            viewer = None
            try:
                viewer = await run_in_threadpool(bench.viewers.open, path, is_growing=is_growing)
                is_announced, notes = False, 0
                while not viewer.problem and not request.scope["is_ending"]():
                    if not is_announced and (is_announced := viewer.has_begun):
                        yield _line(frame=f"/rerun/{viewer.key}", late_s=late_s, is_growing=is_growing)
                    for note in viewer.notes[notes:]:
                        notes += 1
                        yield _line(note=note)
                    await anyio.sleep(_POLL_S)
                yield _line(problem=viewer.problem or "bc-web has ended")
            except UserError as error:
                yield _line(problem=printable(str(error)))
            finally:  # also when the page is closed
                if viewer is not None:
                    bench.viewers.end(viewer)

        return StreamingResponse(lines(), media_type="application/x-ndjson")

    return [Route(f"/{place}/{{log}}/rerun", open_log, methods=["POST"])]


def _line(**values: object) -> str:
    return json.dumps(values) + "\n"
