"""What the page of a log has of a drive: who drove, what was predicted and sent, the road, the events."""

from __future__ import annotations

import msgspec
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from web.folders.project_folders import Place
from web.logs.drive_course import course_columns, road_of
from web.logs.drive_view import drive_events
from web.pages.workbench import Workbench


def course_routes(bench: Workbench, place: Place) -> list[Route]:
    def course(request: Request) -> Response:
        """The events, and the edges of the road, or null."""
        with bench.logs.open(bench.folders.log(place, request.path_params["log"])) as opened:
            events = drive_events(opened.log, opened.states.row, opened.states.time_ns)
            return JSONResponse({"events": msgspec.to_builtins(events), "road": road_of(opened.log)})

    def columns(request: Request) -> Response:
        """The columns of the course (`drive_course.COLUMNS`), one after the other, as float32."""
        with bench.logs.open(bench.folders.log(place, request.path_params["log"])) as opened:
            data = course_columns(opened.log, opened.states.row).astype("<f4").tobytes()
        return Response(data, media_type="application/octet-stream")

    at = f"/{place}/{{log}}/course"
    return [Route(at, course), Route(f"{at}/rows", columns)]
