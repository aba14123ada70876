"""The list of runs; the curves of chosen ones over each other, and what their settings differ in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from starlette.datastructures import QueryParams
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import printable
from model.runs_cli import SORTED_BY, driven_words, order_of
from web.data.run_cards import RunCard
from web.data.run_curves import run_curves
from web.data.run_settings import differing, run_settings
from web.pages.changes import runs_version
from web.pages.workbench import Workbench
from web.server.templates import render

PATIENCE_S: Final = 1.0
"""For runs that are being read: the first one loads PyTorch."""
MOST_CHOSEN: Final = 8
"""Runs whose curves lie over each other: there are so many colours."""


@dataclass(frozen=True)
class AskedRuns:
    """What the form above the list asks for."""

    text: str
    sort: str
    chosen: tuple[str, ...]  # keys of runs

    @classmethod
    def of(cls, query: QueryParams) -> AskedRuns:
        """What makes no sense is as if it were not there."""
        sort = query.get("sort", "newest")
        chosen = tuple(dict.fromkeys(query.getlist("run")))[:MOST_CHOSEN]
        return cls(query.get("text", "").strip(), sort if sort in SORTED_BY else "newest", chosen)


def run_list_routes(bench: Workbench) -> list[Route]:
    def page(request: Request) -> Response:
        live = runs_version(bench)  # before the runs are read
        asked = AskedRuns.of(request.query_params)
        return HTMLResponse(
            render("runs.html", asked=asked, live=live, sorts=list(SORTED_BY), **_list(asked), **_differing(asked))
        )

    def rows(request: Request) -> Response:
        return HTMLResponse(render("run_rows.html", **_list(AskedRuns.of(request.query_params))))

    def differences(request: Request) -> Response:
        return HTMLResponse(render("run_differences.html", **_differing(AskedRuns.of(request.query_params))))

    def curves(request: Request) -> Response:
        """Of each chosen run, its lines; or why it has none."""
        found = []
        for key, path in _chosen(AskedRuns.of(request.query_params)):
            told: dict[str, Any] = {"key": key, "name": printable(path.name), "lines": {}, "problem": ""}
            try:
                told["lines"] = run_curves(bench.runs.history(path))
            except UserError as error:
                told["problem"] = printable(str(error))
            found.append(told)
        return JSONResponse(found)

    def _list(asked: AskedRuns) -> dict[str, Any]:
        folder = bench.folders.runs
        cards = bench.runs.cards(PATIENCE_S)
        return {
            "cards": _sorted([card for card in cards if _has(card, asked.text)], asked.sort),
            "total": len(cards),
            "chosen": {key: number for number, (key, _) in enumerate(_chosen(asked), 1)},
            "driven": driven_words,
            "folder": printable(str(folder)),
            "problem": bench.folders.runs_problem,
        }

    def _chosen(asked: AskedRuns) -> list[tuple[str, Any]]:
        there = bench.folders.run_folders()
        return [(key, there[key]) for key in asked.chosen if key in there]

    def _differing(asked: AskedRuns) -> dict[str, Any]:
        names, settings, problems = [], [], []
        for _, path in _chosen(asked):
            try:
                settings.append(run_settings(path))
            except UserError as error:
                problems.append(printable(str(error)))
            else:
                names.append(printable(path.name))
        return {"names": names, "rows": differing(settings), "problems": problems}

    return [
        Route("/runs", page),
        Route("/runs.rows", rows),
        Route("/runs.differences", differences),
        Route("/runs.curves", curves),
    ]


def _sorted(cards: Sequence[RunCard], by: str) -> list[RunCard]:
    """Those that cannot be read, or are not read yet, come last."""
    known = [(order_of(by, card.summary), card) for card in cards if card.summary]
    known.sort(key=lambda pair: pair[0])
    return [card for _, card in known] + [card for card in cards if not card.summary]


def _has(card: RunCard, text: str) -> bool:
    """Whether all words of the text are in what is told of the run."""
    told = [card.name, card.state]
    if card.summary:
        told += [card.summary.network, card.summary.recipe, *card.summary.sessions]
    lower = " ".join(told).casefold()
    return all(word in lower for word in text.casefold().split())
