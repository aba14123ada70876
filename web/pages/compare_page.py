"""Two runs on the same frames: which is better, by how much, and how certain that is."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from common.errors import printable
from common.files import session_name
from web.errors import WebError
from web.jobs.jobs import Job
from web.logs.drive_view import DriveView, drive_map
from web.logs.session_cards import SessionCard
from web.pages.request_values import Values, on_form
from web.pages.workbench import Workbench
from web.runs.run_charts import run_colours
from web.runs.run_comparisons import compare_command, comparison_of, in_words, is_outdated
from web.server.templates import page

_PATIENCE_S: Final = 0.5


def compare_routes(bench: Workbench) -> list[Route]:
    def start(request: Request, values: Values) -> Response:
        """Start a comparison, unless it is running, or has a result of the present weights."""
        query = _query(values)
        address = f"/runs.compare?{urlencode(query)}"
        command, runs = _command(**query), _runs(query["a"], query["b"])
        job = _newest_job(command)
        if job is None or not (job.is_running or (comparison_of(job) and not is_outdated(job, runs))):
            bench.jobs.start(command, address)
        return RedirectResponse(address, status_code=303)

    def _command(a: str, b: str, session: str) -> list[str]:
        logs = bench.folders.logs("sessions")
        if session and session not in logs:
            raise WebError(f"no session {session!r}", 404)
        return compare_command(*_runs(a, b), session_name(logs[session]) if session else "", bench.folders)

    def _runs(a: str, b: str) -> tuple[Path, Path]:
        if a == b:
            raise WebError("a comparison needs two runs: choose a second one", 422)
        return bench.folders.run(a), bench.folders.run(b)

    def whole(request: Request) -> Response:
        live, query = bench.jobs.version(), _query(request.query_params)
        runs = _runs(query["a"], query["b"])
        names = [printable(run.name) for run in runs]
        command = _command(**query)
        job = _newest_job(command)
        comparison = comparison_of(job) if job else None
        return page(
            "compare.html",
            **query,
            live=live,
            names=names,
            query=urlencode(query),
            sessions=bench.folders.finished("sessions"),
            command=printable(shlex.join(command)),
            job=job,
            comparison=comparison,
            words=in_words(comparison, *names) if comparison else [],
            **_last_drives(bench, runs),
            is_outdated=bool(job and comparison and is_outdated(job, runs)),
        )

    def _newest_job(command: list[str]) -> Job | None:
        return next((job for job in bench.jobs.all() if job.about.words == command), None)

    return [
        Route("/runs.compare", whole),
        Route("/runs.compare", on_form(start), methods=["POST"]),
    ]


def _last_drives(bench: Workbench, runs: Sequence[Path]) -> dict[str, Any]:
    """The newest test drives of two networks on one road, with their map; none without two of them."""
    cards = [(card.info, card) for card in bench.cards.cards("drives", _PATIENCE_S) if card.info]
    newest: dict[tuple[str, str], SessionCard] = {}
    for info, card in sorted(cards, key=lambda pair: pair[0].start, reverse=True):
        newest.setdefault((info.session.get("track", ""), info.session.get("run", "")), card)
    names, roads = [run.name for run in runs], dict.fromkeys(road for road, _ in newest if road)
    pairs = [[newest.get((road, name)) for name in names] for road in roads]
    pair = [card for card in next((pair for pair in pairs if all(pair)), []) if card]
    views = bench.drives.views([card.path for card in pair], _PATIENCE_S)
    drives = [view for card in pair if isinstance(view := views.get(card.path), DriveView)]
    if len(drives) < len(names):
        return {"on_map": [], "map": None}
    colours = [run_colours(names)[name] for name in names]
    return {
        "on_map": [{"card": card, "view": view} for card, view in zip(pair, drives, strict=True)],
        "map": drive_map(drives, colours, "drive"),
        "colours": colours,
    }


def _query(values: Mapping[str, str]) -> dict[str, str]:
    return {name: values.get(name, "") for name in ("a", "b", "session")}
