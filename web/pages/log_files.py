"""Parts of a log that pages load: film strip, steering sketch, pictures, attention maps, links to runs, and the
steering that a run predicts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common.car import CAMERAS, Camera
from common.errors import printable
from common.files import session_name
from common.untrusted import real_path
from model.runs.run_files import CONFIG, WEIGHTS
from recorder import LogError
from recorder.pictures.picture_size import PNG_START
from recorder.topics import camera_topic
from web.errors import WebError, or_404
from web.folders.file_versions import version_of
from web.folders.project_folders import Place, is_recording, key_of, version_of_log
from web.index.index_view import bins_of_index
from web.logs.film_strip import film_strip, steering_sketch
from web.logs.open_logs import OpenLog
from web.pages.request_values import number_in
from web.pages.workbench import Workbench
from web.processes.predictions import Measured
from web.runs.run_configs import check_network, origin_of
from web.server.templates import KEPT, page

if TYPE_CHECKING:  # these load PyTorch, which only requests need
    from dataset.picture_spec import PictureSpec
    from model.network.picture_network import PictureNetwork


_COLOR: Final = (255, 40, 230)  # BGR; no road has this colour
_MAX_ALPHA: Final = 0.8  # where the network looks most
_UNSEEN_ALPHA: Final = 0.45  # of the black over the rows outside the crop
_MAX_WIDTH_PX: Final = 640
_ONE_AT_A_TIME: Final = threading.Lock()


def attention_overlay(run: Path, log: Path, encoded: bytes) -> bytes:
    """A PNG with the shape of the picture: coloured where the network looks, dark outside its crop.

    Raises RunError for a run that cannot be loaded, or a network without an attention map; WebError for a user's
    own network code, and for a picture that does not decode.
    """
    import torch

    from dataset.preprocessing import decode, preprocess
    from model.errors import RunError
    from model.evaluation.predict import as_input
    from model.network.visual_backprop import visual_backprop

    try:
        picture = decode(encoded)
    except ValueError as error:
        raise WebError(f"{log}: this picture does not decode ({error})", 422) from None
    with _ONE_AT_A_TIME:
        torch.set_num_threads(1)  # on a busy machine, several threads for one picture take 20 times as long
        check_network(run, log)
        version = version_of(run / WEIGHTS, run / CONFIG)
        network, spec = _network(run, version)
        try:
            _, maps = visual_backprop(network, as_input(preprocess(picture, spec)[None]))
        except RunError as error:
            raise RunError(f"{run}: {error}") from None
    return _drawn(maps[0].numpy(), picture.shape[0], picture.shape[1], spec)


@lru_cache(maxsize=2)
def _network(run: Path, version: str) -> tuple[PictureNetwork, PictureSpec]:
    from model.runs.run_folder import load_network, picture_of_run

    return load_network(run), picture_of_run(run)


def _drawn(attention: NDArray[np.float32], height: int, width: int, spec: PictureSpec) -> bytes:
    """`attention` (spec.height_px, spec.width_px), 0 to 1, over the rows of a picture that the network sees."""
    scale = min(1.0, _MAX_WIDTH_PX / width)
    size = max(1, round(height * scale)), max(1, round(width * scale))
    alpha = np.full(size, _UNSEEN_ALPHA, np.float32)
    color = np.zeros((*size, 3), np.uint8)
    rows = spec.crop_slice(size[0])
    part = alpha[rows]
    part[:] = _MAX_ALPHA * cv2.resize(attention, (part.shape[1], part.shape[0]), interpolation=cv2.INTER_LINEAR)
    color[rows] = _COLOR
    ok, png = cv2.imencode(".png", np.dstack([color, np.rint(255 * alpha).astype(np.uint8)]))
    assert ok  # noqa: S101 - of any array of that type
    return png.tobytes()


_JPEG_START: Final = b"\xff\xd8\xff"


def log_file_routes(bench: Workbench, place: Place) -> list[Route]:
    def path_of(request: Request) -> Path:
        return bench.folders.log(place, request.path_params["log"])

    def cached(request: Request, kind: str, make: Callable[[OpenLog], bytes], media_type: str) -> Response:
        path = path_of(request)
        version = version_of_log(path)
        key = f"{kind} {real_path(path)} {version}"
        data = bench.cache.get(key, lambda: make(bench.logs.open(path)))
        return Response(data, media_type=media_type, headers=_kept(request, version))

    def strip(request: Request) -> Response:
        return cached(request, "strip 1", lambda opened: film_strip(opened.log), "image/jpeg")

    def sketch(request: Request) -> Response:
        bins = bins_of_index(bench.folders.index)
        return cached(
            request,
            f"sketch 3 {bins}",
            lambda opened: steering_sketch(opened.states.steering, bins),
            "image/svg+xml",
        )

    def picture(request: Request) -> Response:
        opened = bench.logs.open(path_of(request))
        data = _picture(request, opened, _camera_of(request))
        media_type = _type_of(data, number_in(request, "row"))
        return Response(data, media_type=media_type, headers=_kept(request, opened.version))

    def attention(request: Request) -> Response:
        """The attention map of a run's network for the centre camera's picture of a row."""
        path, run = path_of(request), bench.folders.run(request.path_params["run"])
        encoded = _picture(request, bench.logs.open(path), "center")
        return Response(attention_overlay(run, path, encoded), media_type="image/png")

    def links(request: Request) -> Response:
        """Links to the runs that learnt from a log, and to the run that drove."""
        path = path_of(request)
        runs, name = bench.folders.run_folders(), session_name(path)
        learnt = [
            (printable(run.name), f"/runs/{key}") for key, run in runs.items() if name in origin_of(run).sessions
        ]
        opened = bench.logs.open(path)
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
        opened = bench.logs.open(path)
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
        data = predicted.at(bench.logs.open(path).states.row).astype("<f8").tobytes()
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
