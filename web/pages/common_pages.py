"""What networks, recordings and drives have in common: titles and notes, jobs that export them, and downloads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from starlette.requests import Request
from starlette.responses import FileResponse, RedirectResponse, Response
from starlette.routing import Route

from common.errors import printable
from common.files import session_name
from web.errors import WebError, or_404
from web.folders.notes import write_note
from web.folders.project_folders import PLACES, Place
from web.jobs.exports import LOG_EXPORTS, RUN_EXPORTS, ExportKind
from web.pages.request_values import Values, on_form
from web.pages.workbench import Workbench


def common_routes(bench: Workbench) -> list[Route]:
    def exporter(kinds: Sequence[ExportKind], source_of: Callable[[str], Path]) -> Callable[[Request], Response]:
        def export(request: Request) -> Response:
            source, name = source_of(request.path_params["key"]), request.path_params["export"]
            kind = or_404(next((kind for kind in kinds if kind.name == name), None), f"{name}: no such export")
            if kind.missing:
                raise WebError(f"{kind.title}: `{kind.missing}` brings what it needs", 501)
            words, made = bench.exports.words(kind, source, printable(session_name(source)))
            return RedirectResponse(f"/jobs/{bench.jobs.start(words, made).key}", status_code=303)

        return export

    def download_log(place: Place) -> Callable[[Request], Response]:
        def download(request: Request) -> Response:
            path = bench.folders.log(place, request.path_params["key"])
            return FileResponse(path, filename=printable(path.name))

        return download

    def download(request: Request) -> Response:
        path = bench.exports.file(request.path_params["key"], request.path_params["name"])
        return FileResponse(path, filename=path.name)

    def log_of(place: Place) -> Callable[[str], Path]:
        return lambda key: bench.folders.log(place, key)

    def noter(source_of: Callable[[str], Path]) -> Callable[[Request, Values], Response]:
        def note(request: Request, values: Values) -> Response:
            write_note(source_of(request.path_params["key"]), values.get("title", ""), values.get("note", ""))
            return RedirectResponse(request.url.path.removesuffix("/note"), status_code=303)

        return note

    routes = [Route("/exports/{key}/{name}", download)]
    for place in PLACES:
        at, of_log = f"/{place}/{{key}}", log_of(place)
        routes.append(Route(f"{at}/export/{{export}}", exporter(LOG_EXPORTS, of_log), methods=["POST"]))
        routes.append(Route(f"{at}/note", on_form(noter(of_log)), methods=["POST"]))
        routes.append(Route(f"{at}/mcap", download_log(place)))
    of_run = bench.folders.run
    routes.append(Route("/runs/{key}/export/{export}", exporter(RUN_EXPORTS, of_run), methods=["POST"]))
    routes.append(Route("/runs/{key}/note", on_form(noter(of_run)), methods=["POST"]))
    return routes
