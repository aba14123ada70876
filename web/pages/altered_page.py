"""Augmentations: samples as training sees them, beside the pictures that they were made of."""

from __future__ import annotations

from pathlib import Path

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from web.data.altered_samples import altered_samples
from web.data.project_folders import key_of
from web.errors import WebError
from web.pages.workbench import Workbench
from web.server.templates import render


def altered_routes(bench: Workbench) -> list[Route]:
    def folder_of(trial: str) -> Path:
        return bench.trials.get(trial) if trial else bench.folders.index

    def rows(request: Request) -> Response:
        trial, others = request.query_params.get("trial", ""), _number(request.query_params.get("others", "0"))
        found = altered_samples(folder_of(trial), others, bench.cache)
        shown = [(number, sample, key_of(Path(sample.session))) for number, sample in enumerate(found.shown)]
        return HTMLResponse(render("altered_rows.html", found=found, shown=shown, trial=trial, others=others))

    def picture(request: Request) -> Response:
        """The picture as it was driven (0), or as training sees it (1)."""
        number, which = request.path_params["number"], request.path_params["which"]
        trial, others = request.query_params.get("trial", ""), _number(request.query_params.get("others", "0"))
        shown = altered_samples(folder_of(trial), others, bench.cache).shown
        if number >= len(shown) or which > 1 or not shown[number].pictures[which]:
            raise WebError(f"no such picture of sample {number}", 404)
        return Response(shown[number].jpeg(which), media_type="image/jpeg")

    return [
        Route("/index.altered", rows),
        Route("/index.altered/{number:int}/{which:int}.jpg", picture),
    ]


def _number(text: str) -> int:
    """Whoever types no number gets the first ones."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 7 else 0
