"""Parts of a log that pages load: film strip, steering sketch, pictures, attention maps, links to runs, and the
steering that a run predicts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common.car import CAMERAS, Camera
from common.errors import printable
from common.files import session_name
from common.untrusted import real_path
from recorder import LogError
from recorder.pictures.picture_size import PNG_START
from recorder.topics import camera_topic
from web.errors import WebError, or_404
from web.folders.project_folders import Place, is_recording, key_of, version_of_log
from web.index.index_view import bins_of_index
from web.logs.film_strip import film_strip
from web.logs.open_logs import OpenLog
from web.logs.steering_sketch import steering_sketch
from web.pages.request_values import number_in
from web.pages.workbench import Workbench
from web.processes.predictions import Measured
from web.runs.attention import attention_overlay
from web.runs.run_configs import check_network, origin_of
from web.server.static_files import KEPT
from web.server.templates import page

_JPEG_START: Final = b"\xff\xd8\xff"


def log_file_routes(bench: Workbench, place: Place) -> list[Route]:
    def path_of(request: Request) -> Path:
        return bench.folders.log(place, request.path_params["log"])

    def cached(request: Request, kind: str, make: Callable[[OpenLog], bytes], media_type: str) -> Response:
        path = path_of(request)
        version = version_of_log(path)

        def made() -> bytes:
            with bench.logs.open(path) as opened:
                return make(opened)

        data = bench.cache.get(f"{kind} {real_path(path)} {version}", made)
        return Response(data, media_type=media_type, headers=_kept(request, version))

    def strip(request: Request) -> Response:
        return cached(request, "strip 1", lambda opened: film_strip(opened.log), "image/jpeg")

    def sketch(request: Request) -> Response:
        bins = bins_of_index(bench.folders.index)

        def make(opened: OpenLog) -> bytes:
            return steering_sketch(opened.states.steering, bins)

        return cached(request, f"sketch 3 {bins}", make, "image/svg+xml")

    def picture(request: Request) -> Response:
        with bench.logs.open(path_of(request)) as opened:
            data = _picture(request, opened, _camera_of(request))
            media_type = _type_of(data, number_in(request, "row"))
            return Response(data, media_type=media_type, headers=_kept(request, opened.version))

    def attention(request: Request) -> Response:
        """The attention map of a run's network for the centre camera's picture of a row."""
        path, run = path_of(request), bench.folders.run(request.path_params["run"])
        with bench.logs.open(path) as opened:
            encoded = _picture(request, opened, "center")
        data = attention_overlay(run, path, encoded)
        return Response(data, media_type="image/png")

    def links(request: Request) -> Response:
        """Links to the runs that learnt from a log, and to the run that drove."""
        path = path_of(request)
        runs, name = bench.folders.run_folders(), session_name(path)
        learnt = [
            (printable(run.name), f"/runs/{key}") for key, run in runs.items() if name in origin_of(run).sessions
        ]
        with bench.logs.open(path) as opened:
            driver = opened.log.metadata.get("run", "")
        key = key_of(bench.folders.runs / driver) if driver else ""
        drove = printable(driver), f"/runs/{key}" if key in runs else ""
        return page("log_links.html", learnt=learnt, drove=drove)

    def prediction(request: Request) -> Response:
        """The state of a prediction. POST starts the work, unless it is done."""
        path = path_of(request)
        run = bench.folders.run(request.path_params["run"])
        if is_recording(path):
            raise WebError("this log is being recorded: wait until the recording has ended", 409)
        with bench.logs.open(path) as opened:
            fingerprint = opened.log.fingerprint
            if fingerprint != request.query_params.get("log", ""):
                raise WebError(
                    "the log has changed since this page was opened: choose the run again, or reload the page", 409
                )
            key = bench.predictions.key(fingerprint, run)

            def about() -> Measured | None:
                predicted = bench.predictions.find(key)
                return predicted.about if predicted else None

            def start() -> None:
                check_network(run, path)
                pictures = len(opened.log.pictures(camera_topic("center")).sequence)
                if not pictures:
                    raise WebError("this log has no picture of the centre camera, which the network needs", 422)
                bench.predictions.start(key, path, fingerprint, run, pictures)

            state = bench.predictions.work.state(key, about, start if request.method == "POST" else None)
        return JSONResponse({"name": printable(run.name), **state})

    def stop_prediction(request: Request) -> Response:
        """Stop the prediction of a run for a log, for all pages that wait for it."""
        path_of(request)
        run = bench.folders.run(request.path_params["run"])
        bench.predictions.work.stop(bench.predictions.key(request.query_params.get("log", ""), run))
        return Response(status_code=204)

    def predicted_steering(request: Request) -> Response:
        """The predicted steering of each row of the log, as float64; NaN for none."""
        path = path_of(request)
        predicted = bench.predictions.find(request.path_params["key"])
        predicted = or_404(predicted, "this prediction is no longer kept: choose the run again")
        with bench.logs.open(path) as opened:
            data = predicted.at(opened.states.row).astype("<f8").tobytes()
        return Response(data, media_type="application/octet-stream")

    at = f"/{place}/{{log}}"
    return [
        Route(f"{at}/strip.jpg", strip),
        Route(f"{at}/steering.svg", sketch),
        Route(f"{at}/pictures/{{camera}}/{{row}}", picture),
        Route(f"{at}/attention/{{run}}/{{row}}", attention),
        Route(f"{at}/links", links),
        Route(f"{at}/predictions/{{run}}", prediction, methods=["GET", "POST"]),
        Route(f"{at}/predictions/{{run}}/stop", stop_prediction, methods=["POST"]),
        Route(f"{at}/predictions/rows/{{key}}", predicted_steering),
    ]


def _picture(request: Request, opened: OpenLog, camera: Camera) -> bytes:
    """The picture of the request's row. Raises WebError if the log has changed since the page read it."""
    if request.query_params.get("v", opened.version) != opened.version:
        raise WebError("the log has changed since this page was opened: reload it", 409)
    try:
        return opened.log.picture(number_in(request, "row"), camera)
    except LogError as error:
        raise WebError(str(error), 404) from None


def _camera_of(request: Request) -> Camera:
    name = request.path_params["camera"]
    camera = next((camera for camera in CAMERAS if camera == name), None)
    return or_404(camera, f"{name}: no such camera; expected {', '.join(CAMERAS)}")


def _type_of(data: bytes, row: int) -> str:
    """The media type of a picture. Raises WebError for any other data."""
    if data.startswith(_JPEG_START):
        return "image/jpeg"
    if data.startswith(PNG_START):
        return "image/png"
    raise WebError(f"row {row}: its picture is neither JPEG nor PNG", 415)


def _kept(request: Request, version: str) -> dict[str, str]:
    """The headers of an answer: the browser keeps it if its address names this version."""
    return KEPT if request.query_params.get("v") == version else {}
