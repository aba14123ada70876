"""The pictures of logs as a map by what they show, of one log or of all in the index."""

from __future__ import annotations

import contextlib
import re
from functools import partial
from pathlib import Path
from typing import Any, Final

from starlette.datastructures import QueryParams
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import printable
from common.files import PART_SUFFIX
from common.location import absolute
from dataset.frames.frames_file import session_name
from dataset.index.build_state import read_state
from model.runs.run_files import CONFIG, WEIGHTS
from web.errors import WebError
from web.folders.project_folders import PLACES, key_of, shown_name
from web.pages.workbench import Workbench
from web.processes.picture_maps import MappedLog
from web.runs.run_networks import NETWORK_FILES, can_be_run, check_network
from web.server.templates import page

_KEY: Final = re.compile(r"[0-9a-f]{64}")
_PIXELS: Final = "pixels"


def map_routes(bench: Workbench) -> list[Route]:
    def whole(request: Request) -> Response:
        of = request.query_params.getlist("of")
        logs = [_place_and_key(each) for each in of]
        paths = [bench.folders.log(place, key) for place, key in logs]
        names = [shown_name(path) for path in paths]
        folders = _runs(bench)
        runs = [(key, printable(path.name)) for key, path in folders.items()]
        run = request.query_params.get("run", "")
        if run not in (_PIXELS, *folders):
            run = next((key for key in reversed(folders) if can_be_run(folders[key])), _PIXELS)
        shown = [(name, f"/{place}/{key}") for name, (place, key) in zip(names, logs, strict=True)]
        at = f"/{logs[0][0]}" if logs else "/index"
        return page("map.html", of=shown, at=at, runs=runs, run=run, pixels=_PIXELS)

    def state(request: Request) -> Response:
        """The state of a map. POST begins with it where it has not been made yet."""
        logs, run = _asked(bench, request.query_params)
        key = bench.maps.key(logs, run)
        shown = {"logs": [_shown(bench, log) for log in logs]}
        if not logs:
            problem = "no session is in the index; build it, or open the map of a session from its page"
            return JSONResponse({**shown, "key": key, "about": None, "problem": problem})
        start = partial(bench.maps.start, key, logs, run) if request.method == "POST" else None
        return JSONResponse(shown | bench.maps.work.state(key, lambda: bench.maps.find(key), start))

    def stop(request: Request) -> Response:
        """End it, for all pages that wait for it."""
        bench.maps.work.stop(_key_in(request))
        return Response(status_code=204)

    def points(request: Request) -> Response:
        """The columns of a map as float32, one after the other."""
        data = bench.maps.columns(_key_in(request))
        if data is None:
            raise WebError("this map is no longer kept: make it again", 404)
        return Response(data, media_type="application/octet-stream")

    return [
        Route("/map", whole),
        Route("/map.state", state, methods=["GET", "POST"]),
        Route("/map.stop", stop, methods=["POST"]),
        Route("/map.points", points),
    ]


def _key_in(request: Request) -> str:
    key = request.query_params.get("key", "")
    if not _KEY.fullmatch(key):
        raise WebError("no such map", 404)
    return key


def _place_and_key(of: str) -> tuple[Any, str]:
    place, _, key = of.partition("/")
    if place not in PLACES:
        raise WebError(f"{printable(of[:80])}: no log; sessions/NAME or drives/NAME was expected", 404)
    return place, key


def _runs(bench: Workbench) -> dict[str, Path]:
    """The runs that have weights, the newest last; in a store, as far as is known, all of them."""
    times = {}
    for key, path in bench.folders.run_folders().items():
        with contextlib.suppress(OSError):
            is_here = bench.folders.run_place(path) == path
            times[key] = (path / (WEIGHTS if is_here else CONFIG)).stat().st_mtime, path
    return {key: times[key][1] for key in sorted(times, key=lambda key: times[key])}


def _asked(bench: Workbench, query: QueryParams) -> tuple[list[MappedLog], Path | None]:
    """The logs that an address names, or all of the index; and the run, None for pixels."""
    of = query.getlist("of")
    logs = [_log(bench, each) for each in of] if of else _of_index(bench)
    name = query.get("run", _PIXELS)
    run = None if name == _PIXELS else bench.folders.run(name)
    if run is not None:
        bench.folders.bring_run(run, NETWORK_FILES)
        first = logs[0].path if logs else bench.folders.sessions
        check_network(run, first, bench.folders.run_place(run))
    return logs, run


def _log(bench: Workbench, of: str) -> MappedLog:
    place, key = _place_and_key(of)
    path = bench.folders.log(place, key)
    if path.name.endswith(PART_SUFFIX):
        raise WebError(f"{path}: unfinished; its pictures can be shown when it is whole", 409)
    with bench.logs.open(path) as opened:
        return MappedLog(f"/{place}/{key}", path, opened.log.fingerprint)


def _of_index(bench: Workbench) -> list[MappedLog]:
    """The logs that the index holds, as it has read them."""
    bench.folders.refresh_index()
    built = read_state(bench.folders.index_here).logs
    found = []
    for path in bench.folders.logs("sessions").values():
        entry = built.get(session_name(path))
        if entry is not None and entry.fingerprint and entry.sources[0] == str(absolute(path)):
            found.append(MappedLog(f"/sessions/{key_of(path)}", path, entry.fingerprint))
    return found


def _shown(bench: Workbench, log: MappedLog) -> dict[str, object]:
    """A log as a page needs it: its pictures' address, and the tags that its rows have now."""
    tags: list[tuple[int, int, str]] = []
    with contextlib.suppress(UserError):  # its own page names it
        for tag in bench.cards.tags(log.path, log.fingerprint).tags:
            tags.append((tag.first_row, tag.last_row, tag.name))
    return {
        "at": log.at,
        "name": shown_name(log.path),
        "version": bench.folders.version_of(log.path),
        "fingerprint": log.fingerprint,
        "tags": tags,
    }
