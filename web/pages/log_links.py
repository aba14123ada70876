"""Links of a log: to the runs that learnt from it, and from a drive to the run that drove."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from common.errors import printable
from dataset.frames.frames_file import session_name
from web.folders.project_folders import Place, key_of
from web.pages.workbench import Workbench
from web.runs.run_origins import origin_of
from web.server.templates import render


def log_link_routes(bench: Workbench, place: Place) -> list[Route]:
    def links(request: Request) -> Response:
        path = bench.folders.log(place, request.path_params["log"])
        runs = bench.folders.run_folders()
        name = session_name(path)
        learnt = [
            (printable(run.name), f"/runs/{key}") for key, run in runs.items() if name in origin_of(run).sessions
        ]
        with bench.logs.open(path) as opened:
            driver = opened.log.metadata.get("run", "")
        key = key_of(bench.folders.runs / driver) if driver else ""
        drove = printable(driver), f"/runs/{key}" if key in runs else ""
        return HTMLResponse(render("log_links.html", learnt=learnt, drove=drove))

    return [Route(f"/{place}/{{log}}/links", links)]
