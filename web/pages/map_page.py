"""Maps of pictures, of one log or of all logs in the index. Similar pictures lie near each other."""

from __future__ import annotations

import contextlib
from functools import partial
from pathlib import Path
from typing import Any, Final

from starlette.datastructures import QueryParams
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import printable
from common.files import PART_SUFFIX, session_name
from common.untrusted import real_path
from dataset.index.build_state import read_state
from model.runs.run_files import WEIGHTS
from recorder.log.tags import Tag
from web.errors import WebError, or_404
from web.folders.file_versions import version_of
from web.folders.project_folders import PLACES, key_of, shown_name
from web.pages.workbench import Workbench
from web.processes.picture_maps import MappedLog
from web.runs.run_configs import can_be_run, check_network
from web.server.templates import page

_PIXELS: Final = "pixels"


def map_routes(bench: Workbench) -> list[Route]:
    def whole(request: Request) -> Response:
        logs = [_place_and_key(address) for address in request.query_params.getlist("of")]
        shown = [(shown_name(bench.folders.log(place, key)), f"/{place}/{key}") for place, key in logs]
        folders = _runs(bench)
        runs = [(key, printable(path.name)) for key, path in folders.items()]
        run = request.query_params.get("run", "")
        if run not in (_PIXELS, *folders):
            run = next((key for key in reversed(folders) if can_be_run(folders[key])), _PIXELS)
        at = f"/{logs[0][0]}" if logs else "/index"
        return page("map.html", logs=shown, at=at, runs=runs, run=run, pixels=_PIXELS)

    def state(request: Request) -> Response:
        """The state of a map. POST starts the work, unless it is done."""
        logs, run = _logs_and_run(bench, request.query_params)
        key = bench.maps.key(logs, run)
        context = {"logs": [_log_data(bench, log) for log in logs]}
        if not logs:
            problem = "there is no recording yet"
            return JSONResponse({**context, "key": key, "about": None, "problem": problem})
        start = partial(bench.maps.start, key, logs, run) if request.method == "POST" else None
        return JSONResponse(context | bench.maps.work.state(key, lambda: bench.maps.find(key), start))

    def stop(request: Request) -> Response:
        """Stop the work for all pages that wait for it."""
        bench.maps.work.stop(request.query_params.get("key", ""))
        return Response(status_code=204)

    def points(request: Request) -> Response:
        """The columns of a map as float32, one after the other."""
        data = bench.maps.columns(request.query_params.get("key", ""))
        data = or_404(data, "this map is no longer kept: make it again")
        return Response(data, media_type="application/octet-stream")

    return [
        Route("/map", whole),
        Route("/map.state", state, methods=["GET", "POST"]),
        Route("/map.stop", stop, methods=["POST"]),
        Route("/map.points", points),
    ]


def _place_and_key(address: str) -> tuple[Any, str]:
    place, _, key = address.partition("/")
    if place not in PLACES:
        raise WebError(f"{printable(address[:80])}: expected sessions/NAME or drives/NAME", 404)
    return place, key


def _runs(bench: Workbench) -> dict[str, Path]:
    """The runs that have weights, the newest last."""
    times = {}
    for key, path in bench.folders.run_folders().items():
        with contextlib.suppress(OSError):
            times[key] = (path / WEIGHTS).stat().st_mtime, path
    return {key: times[key][1] for key in sorted(times, key=lambda key: times[key])}


def _logs_and_run(bench: Workbench, query: QueryParams) -> tuple[list[MappedLog], Path | None]:
    """The logs that an address names, or all logs of the index; and the run, None for pixels."""
    logs = [_log(bench, address) for address in query.getlist("of")] or _indexed_logs(bench)
    name = query.get("run", _PIXELS)
    run = None if name == _PIXELS else bench.folders.run(name)
    if run is not None:
        first = logs[0].path if logs else bench.folders.sessions
        check_network(run, first)
    return logs, run


def _log(bench: Workbench, address: str) -> MappedLog:
    place, key = _place_and_key(address)
    path = bench.folders.log(place, key)
    if path.name.endswith(PART_SUFFIX):
        raise WebError(f"{path}: unfinished; a map needs a finished log", 409)
    opened = bench.logs.open(path)
    return MappedLog(f"/{place}/{key}", path, opened.log.fingerprint)


def _indexed_logs(bench: Workbench) -> list[MappedLog]:
    """The logs of the index, with the fingerprints that the index has; without an index, all finished logs."""
    built = read_state(bench.folders.index).logs
    logs = []
    for path in bench.folders.logs("sessions").values():
        entry = built.get(session_name(path))
        if entry is not None and entry.fingerprint and entry.sources[0] == str(real_path(path)):
            logs.append(MappedLog(f"/sessions/{key_of(path)}", path, entry.fingerprint))
    return logs or [_log(bench, f"sessions/{key}") for key in bench.folders.finished("sessions")]


def _log_data(bench: Workbench, log: MappedLog) -> dict[str, object]:
    """The data of a log for the page: the address of its pictures, and its present tags."""
    tags: list[Tag] = []
    with contextlib.suppress(UserError):  # the log's own page shows it
        tags = bench.cards.tags(log.path, log.fingerprint).tags
    return {
        "at": log.at,
        "name": shown_name(log.path),
        "version": version_of(log.path),
        "fingerprint": log.fingerprint,
        "tags": tags,
    }
