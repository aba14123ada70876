"""Pictures made of a log: its film strip, the sketch of its steering, and the cameras' own, byte for byte."""

from __future__ import annotations

from typing import Final, get_args

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from common.car import CAMERAS, Camera
from common.location import absolute
from recorder import LogError
from recorder.pictures.picture_size import PNG_START
from web.errors import WebError
from web.folders.project_folders import Place
from web.index.index_view import bins_of_index
from web.logs.film_strip import film_strip
from web.logs.steering_sketch import steering_sketch
from web.pages.address_number import number_in
from web.pages.workbench import Workbench
from web.server.static_files import KEPT

_JPEG_START: Final = b"\xff\xd8\xff"


def log_file_routes(bench: Workbench, place: Place) -> list[Route]:
    def strip(request: Request) -> Response:
        path = bench.folders.log(place, request.path_params["log"])
        version = bench.folders.version_of_log(path)

        def make() -> bytes:
            with bench.logs.open(path) as opened:
                return film_strip(opened.log)

        data = bench.cache.get(f"strip 1 {absolute(path)} {version}", make)
        return Response(data, media_type="image/jpeg", headers=_kept(request, version))

    def sketch(request: Request) -> Response:
        path = bench.folders.log(place, request.path_params["log"])
        version = bench.folders.version_of_log(path)
        bins = bins_of_index(bench.folders.index_here)

        def make() -> bytes:
            with bench.logs.open(path) as opened:
                return steering_sketch(opened.states.steering, bins)

        data = bench.cache.get(f"sketch 3 {bins} {absolute(path)} {version}", make)
        return Response(data, media_type="image/svg+xml", headers=_kept(request, version))

    def picture(request: Request) -> Response:
        camera, row = _camera_of(request), number_in(request, "row")
        with bench.logs.open(bench.folders.log(place, request.path_params["log"])) as opened:
            version = request.query_params.get("v", opened.version)
            if version != opened.version:
                raise WebError("the log has changed since this page was opened: reload it", 409)
            try:
                data = opened.log.picture(row, camera)
            except LogError as error:
                raise WebError(str(error), 404) from None
        return Response(data, media_type=_type_of(data, row), headers=_kept(request, opened.version))

    at = f"/{place}/{{log}}"
    return [
        Route(f"{at}/strip.jpg", strip),
        Route(f"{at}/steering.svg", sketch),
        Route(f"{at}/pictures/{{camera}}/{{row}}", picture),
    ]


def _camera_of(request: Request) -> Camera:
    named = request.path_params["camera"]
    found: Camera | None = next((camera for camera in CAMERAS if camera == named), None)
    if found is None:
        raise WebError(f"{named}: no such camera; expected {', '.join(get_args(Camera))}", 404)
    return found


def _type_of(data: bytes, row: int) -> str:
    """Raises WebError for what no browser should take for a picture."""
    if data.startswith(_JPEG_START):
        return "image/jpeg"
    if data.startswith(PNG_START):
        return "image/png"
    raise WebError(f"row {row}: its picture is neither JPEG nor PNG", 415)


def _kept(request: Request, version: str) -> dict[str, str]:
    """Kept by the browser where the address names this very content."""
    return KEPT if request.query_params.get("v") == version else {}
