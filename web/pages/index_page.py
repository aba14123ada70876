"""The index: bins, each session's share, the split along time, leaks, and what other settings would change."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import counted, printable
from dataset.index.leaks import find_leaks
from dataset.index.sessions import logs_not_indexed
from dataset.samples.samples_format import COUNT_HEADINGS, SAMPLES_NAME
from web.errors import WebError
from web.folders.project_folders import key_of, shown_name
from web.index.index_view import (
    IndexView,
    bins_sketch,
    held_out_rows,
    session_bins_sketch,
    split_sketch,
    view_index,
)
from web.jobs.job_forms import INDEX_FIELDS, form_of
from web.logs.session_cards import IndexState
from web.pages.request_values import Values, on_form
from web.pages.workbench import Workbench
from web.runs.run_origins import index_checksum, origin_of
from web.runs.run_settings import differing
from web.server.templates import page

_INDEX_FORM = "index"
_PATIENCE_S: Final = 0.3


def index_routes(bench: Workbench) -> list[Route]:
    def folder_of(request: Request) -> Path:
        """The index, or the requested trial."""
        trial = request.query_params.get("trial", "")
        return bench.trials.get(trial) if trial else bench.folders.index_here

    def whole(request: Request) -> Response:
        values = dict(request.query_params)
        trial = values.pop("trial", "")
        store_problem = bench.folders.refresh_index()
        here = bench.folders.index_here
        now, problem = _view(here)
        then, trial_problem = _view(bench.trials.get(trial)) if trial else (None, "")
        return page(
            "index.html",
            trial=trial,
            values=values,
            fields=INDEX_FIELDS,
            known=sorted(map(shown_name, bench.folders.logs("sessions").values())),
            now=now,
            then=then,
            is_missing=not (here / SAMPLES_NAME).exists() and not store_problem,
            problem=store_problem or problem.replace(printable(str(here)), printable(str(bench.folders.index))),
            trial_problem=trial_problem,
            stale=_stale(),
            headings=COUNT_HEADINGS,
            settings=differing([now.settings, then.settings]) if now and then else [],
            sessions=_sessions(now, then),
            runs=_runs() if now else [],
        )

    def _stale() -> list[str]:
        """The sessions that are newer than the index, and those whose log or tags have changed since."""
        cards = bench.cards.cards("sessions", _PATIENCE_S)
        names = {card.name for card in cards if card.index.state is IndexState.CHANGED}
        with contextlib.suppress(UserError):
            logs = [log for log in bench.folders.logs("sessions").values() if log.suffix == ".mcap"]
            found = logs_not_indexed(bench.folders.index_here, logs, bench.folders.stat)
            names |= set(map(printable, found))
        return sorted(names)

    def _runs() -> list[tuple[str, str]]:
        """The runs that were trained on the index as it is now, and their pages."""
        now = index_checksum(bench.folders.index_here)
        found = bench.folders.run_folders().items()
        return [(printable(path.name), f"/runs/{key}") for key, path in found if origin_of(path).index == now]

    def bins(request: Request) -> Response:
        return _picture(bins_sketch(view_index(folder_of(request))))

    def session_of(request: Request) -> tuple[Path, str]:
        """The index, and the session in it: nothing else is looked for in its folder."""
        folder, key = folder_of(request), request.path_params["session"]
        for session in view_index(folder).counts:
            if key_of(Path(session)) == key and "/" not in session and "\\" not in session:
                return folder, session
        raise WebError(f"{folder}: no session {key!r} in it", 404)

    def session_bins(request: Request) -> Response:
        return _picture(session_bins_sketch(*session_of(request)))

    def split(request: Request) -> Response:
        return _picture(split_sketch(*session_of(request)))

    def held_out(request: Request) -> Response:
        """The rows of a session that validation has, as [first, last] of their stretches."""
        return JSONResponse(held_out_rows(*session_of(request)))

    def leaks(request: Request) -> Response:
        found = find_leaks(folder_of(request))
        head = "no leak between training and validation" if not found else counted(len(found), "leak")
        return PlainTextResponse("\n".join(map(printable, [head, *found])))

    def try_settings(request: Request, values: Values) -> Response:
        form = form_of(_INDEX_FORM)
        form.words(values, bench.folders)  # before a folder is made
        key, folder = bench.trials.new(bench.folders.index_here)
        words = form.words(values, dataclasses.replace(bench.folders, index=folder))
        kept = {name: value for name, value in values.items() if value and name != "form"}
        job = bench.jobs.start(words, f"/index?{urlencode({'trial': key, **kept})}")
        return RedirectResponse(f"/jobs/{job.key}", status_code=303)

    return [
        Route("/index", whole),
        Route("/index.bins", bins),
        Route("/index.leaks", leaks),
        Route("/index.try", on_form(try_settings), methods=["POST"]),
        Route("/index/{session}/bins", session_bins),
        Route("/index/{session}/split", split),
        Route("/index/{session}/held-out", held_out),
    ]


def _view(folder: Path) -> tuple[IndexView | None, str]:
    try:
        return view_index(folder), ""
    except UserError as error:
        return None, printable(str(error))


def _sessions(now: IndexView | None, then: IndexView | None) -> list[dict[str, Any]]:
    """A row for each session of either: its counts now, and then."""
    names = sorted({session for view in (now, then) if view for session in view.counts})
    return [
        {
            "name": printable(name),
            "key": key_of(Path(name)),
            "now": now.counts.get(name) if now else None,
            "then": then.counts.get(name) if then else None,
        }
        for name in names
    ]


def _picture(data: bytes) -> Response:
    return Response(data, media_type="image/svg+xml")
