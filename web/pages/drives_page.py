"""The list of drives with their results and events, and chosen drives on one map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from common import UserError
from common.errors import printable
from web.folders.project_folders import key_of
from web.logs.drive_view import MAX_ERROR_DEG, WAYS, DriveView, drive_map
from web.pages.workbench import Workbench
from web.runs.run_charts import COLOURS, run_colours
from web.server.templates import page


def drive_routes(bench: Workbench) -> list[Route]:
    def whole(request: Request) -> Response:
        live = bench.drives_version()  # before the drives are read, so that later changes are noticed
        query = request.query_params
        by = query.get("by", "drive") if query.get("by") in WAYS else "drive"
        logs = bench.folders.logs("drives")
        chosen = [key for key in dict.fromkeys(query.getlist("log")) if key in logs][:COLOURS]
        views = bench.drives.views(logs.values())
        cards = bench.cards.cards("drives")
        runs = bench.folders.run_folders()
        drives: list[dict[str, Any]] = []
        problems: list[str] = []
        for card in sorted(cards, key=lambda card: card.info.start if card.info else "", reverse=True):
            result = views.get(card.path)
            view = result if isinstance(result, DriveView) and card.info else None
            problem = card.problem or (printable(str(result)) if isinstance(result, UserError) else "")
            run = card.info.session.get("run", "") if card.info else ""
            key = key_of(bench.folders.runs / run) if run else ""
            drives.append(
                {
                    "card": card,
                    "view": view,
                    "problem": problem,
                    "run": printable(run),
                    "run_key": key if key in runs else "",
                }
            )
        by_key = {drive["card"].key: drive for drive in drives}
        if not query:  # nobody has chosen yet
            chosen = list(by_key)[:1]  # it may still be read
        on_map = [by_key[key] for key in chosen if key in by_key and by_key[key]["view"]]
        colours = _colours(on_map)
        map_of_drives = drive_map([drive["view"] for drive in on_map], colours, by)
        if on_map and map_of_drives is None:
            problems.append("these drives have no poses: their simulator does not report the car's place")
        return page(
            "drives.html",
            live=live,
            drives=drives,
            chosen=chosen,
            on_map=on_map,
            colours=colours,
            map=map_of_drives,
            max_error_deg=MAX_ERROR_DEG,
            reading=sum(not (drive["view"] or drive["problem"]) for drive in drives),
            by=by,
            ways=WAYS,
            problems=problems,
            folder=printable(str(bench.folders.drives)),
        )

    return [Route("/drives", whole)]


def _colours(drives: Sequence[dict[str, Any]]) -> list[int]:
    """Each drive's colour. A run's first drive has the run's colour; its other drives have other colours."""
    names = [drive["run"] or drive["card"].name for drive in drives]
    counts = Counter[str]()
    for at, name in enumerate(names):
        counts[name] += 1
        names[at] = f"{name} {counts[name]}" if counts[name] > 1 else name
    colours = run_colours(names)
    return [colours[name] for name in names]
