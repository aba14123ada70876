"""The predictions of a run for a log: their start, progress and values."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common.errors import printable
from recorder.topics import camera_topic
from web.errors import WebError, or_404
from web.folders.project_folders import Place, is_recording
from web.pages.workbench import Workbench
from web.processes.predictions import Measured
from web.runs.run_configs import NETWORK_FILES, check_network


def prediction_routes(bench: Workbench, place: Place) -> list[Route]:
    def prediction(request: Request) -> Response:
        """The state of a prediction. POST starts the work, unless it is done."""
        path = bench.folders.log(place, request.path_params["log"])
        run = bench.folders.run(request.path_params["run"])
        if is_recording(path):
            raise WebError("this log is being recorded: wait until the recording has ended", 409)
        with bench.logs.open(path) as opened:
            fingerprint = opened.log.fingerprint
            if fingerprint != request.query_params.get("log", ""):
                raise WebError(
                    "the log has changed since this page was opened: choose the run again, or reload the page", 409
                )
            bench.folders.bring_run(run, NETWORK_FILES)
            key = bench.predictions.key(fingerprint, run)

            def about() -> Measured | None:
                predicted = bench.predictions.find(key)
                return predicted.about if predicted else None

            def start() -> None:
                check_network(run, path, bench.folders.run_place(run))
                pictures = len(opened.log.pictures(camera_topic("center")).sequence)
                if not pictures:
                    raise WebError("this log has no picture of the centre camera, which the network needs", 422)
                bench.predictions.start(key, path, fingerprint, run, pictures)

            state = bench.predictions.work.state(key, about, start if request.method == "POST" else None)
        return JSONResponse({"name": printable(run.name), **state})

    def stop(request: Request) -> Response:
        """Stop the prediction of a run for a log, for all pages that wait for it."""
        bench.folders.log(place, request.path_params["log"])
        run = bench.folders.run(request.path_params["run"])
        bench.predictions.work.stop(bench.predictions.key(request.query_params.get("log", ""), run))
        return Response(status_code=204)

    def column(request: Request) -> Response:
        """The predicted steering of each row of the log, as float64; NaN for none."""
        path = bench.folders.log(place, request.path_params["log"])
        predicted = bench.predictions.find(request.path_params["key"])
        predicted = or_404(predicted, "this prediction is no longer kept: choose the run again")
        with bench.logs.open(path) as opened:
            data = predicted.at(opened.states.row).astype("<f8").tobytes()
        return Response(data, media_type="application/octet-stream")

    at = f"/{place}/{{log}}/predictions"
    return [
        Route(f"{at}/{{run}}", prediction, methods=["GET", "POST"]),
        Route(f"{at}/{{run}}/stop", stop, methods=["POST"]),
        Route(f"{at}/rows/{{key}}", column),
    ]
