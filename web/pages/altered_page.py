"""Augmentations: samples as they are trained on, beside the pictures that they were made of."""

from __future__ import annotations

from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from common.whole_number import whole_number
from dataset.samples.samples_format import SAMPLES_NAME
from web.errors import WebError
from web.folders.file_versions import version_of
from web.folders.project_folders import key_of
from web.index.altered_samples import AlteredSamples, altered_samples
from web.pages.request_values import number_in
from web.pages.workbench import Workbench
from web.server.templates import page


def altered_routes(bench: Workbench) -> list[Route]:
    def samples_of(trial: str, others: int) -> AlteredSamples:
        index = bench.trials.get(trial) if trial else bench.folders.index
        here = index if isinstance(index, Path) else bench.folders.index_here
        return altered_samples(index, version_of(here / SAMPLES_NAME), others, bench.cache)

    def rows(request: Request) -> Response:
        trial, others = _chosen(request)
        found = samples_of(trial, others)
        shown = [(number, sample, key_of(Path(sample.session))) for number, sample in enumerate(found.shown)]
        return page("altered_rows.html", found=found, shown=shown, trial=trial, others=others)

    def picture(request: Request) -> Response:
        """The picture as it was driven (0), or as it is trained on (1)."""
        number, which = number_in(request, "number"), number_in(request, "which")
        trial, others = _chosen(request)
        shown = samples_of(trial, others).shown
        if number >= len(shown) or which > 1 or not shown[number].pictures[which]:
            raise WebError(f"no such picture of sample {number}", 404)
        return Response(shown[number].jpeg(which), media_type="image/jpeg")

    return [Route("/index.altered", rows), Route("/index.altered/{number}/{which}.jpg", picture)]


def _chosen(request: Request) -> tuple[str, int]:
    """The index that was tried, "" for the project's own, and the number of the choice of samples."""
    return request.query_params.get("trial", ""), whole_number(request.query_params.get("others", "")) or 0
