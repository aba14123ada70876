"""The attention map of a run's network for the centre camera's picture of a row."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from recorder import LogError
from web.errors import WebError
from web.folders.project_folders import Place
from web.pages.address_number import number_in
from web.pages.workbench import Workbench
from web.runs.run_networks import NETWORK_FILES


def attention_routes(bench: Workbench, place: Place) -> list[Route]:
    def overlay(request: Request) -> Response:
        path = bench.folders.log(place, request.path_params["log"])
        run = bench.folders.run(request.path_params["run"])
        with bench.logs.open(path) as opened:
            if request.query_params.get("v", opened.version) != opened.version:
                raise WebError("the log has changed since this page was opened: reload it", 409)
            try:
                encoded = opened.log.picture(number_in(request, "row"), "center")
            except LogError as error:
                raise WebError(str(error), 404) from None
        bench.folders.bring_run(run, NETWORK_FILES)
        data = bench.attention.overlay(run, bench.folders.run_place(run), path, encoded)
        return Response(data, media_type="image/png")

    return [Route(f"/{place}/{{log}}/attention/{{run}}/{{row}}", overlay)]
