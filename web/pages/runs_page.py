"""The list of runs, the curves of chosen runs over each other, and the differences in their settings."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import printable
from model.runs.run_files import load_config
from model.runs_cli import SORTED_BY, different_frames, driven_words, in_order, marks_of_splits
from web.pages.request_values import has_words
from web.pages.workbench import Workbench
from web.runs.run_cards import RunCard
from web.runs.run_charts import COLOURS, Line, run_colours, run_curves
from web.runs.run_configs import differing, settings_of
from web.server.templates import page


def run_list_routes(bench: Workbench) -> list[Route]:
    def whole(request: Request) -> Response:
        live = bench.runs_version()  # before the runs are read
        text, sort = (request.query_params.get(name, "").strip() for name in ("text", "sort"))
        sort = sort if sort in SORTED_BY else "newest"
        cards = bench.runs.cards()
        shown = _sorted([card for card in cards if has_words(text, _words(card))], sort)
        summaries = [card.summary for card in shown if card.summary]
        chosen = _chosen(request)
        return page(
            "runs.html",
            live=live,
            text=text,
            sort=sort,
            sorts=list(SORTED_BY),
            cards=shown,
            marks=marks_of_splits(summaries),
            different_frames=different_frames(summaries),
            total=len(cards),
            newest=dict(zip("ab", _newest_two(cards), strict=False)),
            chosen=chosen,
            compare=dict(zip("ab", chosen, strict=False)),
            driven=driven_words,
            folder=printable(str(bench.folders.runs)),
            **_differences(chosen.values()),
        )

    def curves(request: Request) -> Response:
        runs = []
        chosen = _chosen(request)
        colours = run_colours(path.name for path in chosen.values())
        for key, path in chosen.items():
            lines: dict[str, Line] = {}
            with contextlib.suppress(UserError):  # its page, and the list, show the problem
                lines = run_curves(bench.runs.history(path))
            runs.append({"key": key, "name": printable(path.name), "lines": lines, "colour": colours[path.name]})
        return JSONResponse(runs)

    def _chosen(request: Request) -> dict[str, Path]:
        """The chosen runs, at most as many as there are colours."""
        folders = bench.folders.run_folders()
        keys = list(dict.fromkeys(request.query_params.getlist("run")))[:COLOURS]
        return {key: folders[key] for key in keys if key in folders}

    return [Route("/runs", whole), Route("/runs.curves", curves)]


def _differences(runs: Iterable[Path]) -> dict[str, Any]:
    """The settings that differ between runs, as `rows`, and the names of the runs that can be read."""
    names, settings, problems = [], [], []
    for path in runs:
        try:
            settings.append(settings_of(load_config(path)))
        except UserError as error:
            problems.append(printable(str(error)))
        else:
            names.append(printable(path.name))
    return {"names": names, "rows": differing(settings), "problems": problems}


def _newest_two(cards: Sequence[RunCard]) -> list[str]:
    """The keys of the newest two runs with weights, the older one first."""
    times = {card.key: card.summary.written_at for card in cards if card.summary and card.summary.kept_epoch}
    return sorted(times, key=lambda key: times[key])[-2:]


def _sorted(cards: Sequence[RunCard], by: str) -> list[RunCard]:
    """The cards in order. Cards without a summary come last."""
    by_summary = {id(card.summary): card for card in cards if card.summary}
    ordered = in_order([card.summary for card in cards if card.summary], by)
    return [by_summary[id(summary)] for summary in ordered] + [card for card in cards if not card.summary]


def _words(card: RunCard) -> list[str]:
    run = card.summary
    return [
        card.name,
        card.note.title,
        card.note.note,
        card.state,
        *([run.network, run.recipe, *run.sessions] if run else []),
    ]
