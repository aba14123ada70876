"""Two runs on the same frames: which is better, by how much, and how certain that is."""

from __future__ import annotations

import contextlib
import math
import shlex
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from common.errors import counted, printable
from common.files import session_name
from common.progress import duration_text
from common.steering_unit import SteeringUnit, steering_unit
from common.untrusted import json_as
from model.evaluation.differences import BLOCK_S, FEWEST_BLOCKS, MEASURES
from model.runs.run_files import WEIGHTS
from web.errors import WebError
from web.jobs.job_forms import as_argument
from web.jobs.jobs import Job
from web.logs.drive_view import DriveView, drive_map
from web.logs.session_cards import SessionCard
from web.pages.request_values import Values, on_form
from web.pages.workbench import Workbench
from web.runs.run_charts import run_colours
from web.server.templates import page

_ENDS_WELL: Final = (0, 1, 3)  # 1: B is worse
_MOST_S: Final = 24 * 3600.0  # nobody drives longer for a comparison


def is_outdated(job: Job, runs: Sequence[Path]) -> bool:
    """Whether the weights of one of the runs have changed since the job began."""
    began_s = datetime.fromisoformat(job.about.began).timestamp()
    with contextlib.suppress(OSError):
        return any((run / WEIGHTS).stat().st_mtime > began_s for run in runs)
    return False


def comparison_of(job: Job) -> dict[str, Any] | None:
    """The comparison that a job has printed, for its page; None if it has printed none."""
    if job.code not in _ENDS_WELL:
        return None
    lines = [line for line in job.output().splitlines() if line.startswith("{")]
    printed = json_as(lines[-1], dict[str, Any]) if lines else None
    return None if printed is None else _comparison(printed)


def _comparison(printed: dict[str, Any]) -> dict[str, Any]:
    unit = steering_unit(printed.get("max_deg", 0.0))
    units = "sessions" if "sessions" in printed else "blocks"
    return {
        "frames": int(printed["frames"]),
        "units": units,
        "unit_count": int(printed[units]),
        "unit": unit,
        "confidence": float(printed["confidence"]),
        "apart": unit.of(float(printed["answers_apart_deg"])),  # root mean square of A's and B's difference
        "verdict": str(printed["verdict"]),
        "learnt": [(run.upper(), int(count)) for run, count in printed.get("learnt", {}).items() if count],
        "skipped": sum(map(int, printed.get("skipped", {}).values())),  # pictures that do not decode
        "measures": [_measure(name, values, unit) for name, values in printed["measures"].items()],
    }


def _measure(name: str, values: dict[str, Any], unit: SteeringUnit) -> dict[str, Any]:
    """A measure of both runs, and the interval of B - A, in the unit of the page; NaN for missing numbers. `reach`
    is the farthest distance of the interval from zero."""
    measure = next((measure for measure in MEASURES if measure.name == name), None)
    per = unit.per_deg if name.endswith("_deg") else 1.0
    numbers = {
        key: math.nan if values[key] is None else per * float(values[key]) for key in ("a", "b", "low", "high")
    }
    ends = (numbers["low"], numbers["high"], numbers["b"] - numbers["a"])
    return {
        **numbers,
        "reach": max((abs(end) for end in ends if math.isfinite(end)), default=0.0),
        "heading": measure.heading if measure else name.replace("_", " "),
        "digits": 3 if measure and measure.scale == 1.0 else 2,
        "sign": unit.sign if name.endswith("_deg") else "",
        "verdict": str(values["verdict"]),
    }


def in_words(comparison: dict[str, Any], a: str, b: str) -> list[str]:
    """Which network is better, by how much and how surely; and what would settle it, if nothing is sure."""
    measures, verdict = comparison["measures"], comparison["verdict"]
    measure = next((measure for measure in measures if measure["verdict"] == verdict), None)
    if measure is None or verdict == "unknown":
        short_s = max(FEWEST_BLOCKS - comparison["unit_count"], 1) * BLOCK_S
        return [f"There are too few frames to compare {a} and {b}: hold out {short_s:.0f} s more of driving."]
    apart, low, high = measure["b"] - measure["a"], measure["low"], measure["high"]
    if low == high == 0:
        return [f"{a} and {b} steer alike on these frames."]

    def more_or_less(value: float) -> str:
        return f"{abs(value):.{measure['digits']}f}{measure['sign']} {'higher' if value > 0 else 'lower'}"

    share = f" ({abs(apart / measure['a']):.0%})" if measure["a"] else ""
    is_what = f"{verdict} than" if verdict in ("better", "worse") else "not shown to be better or worse than"
    near, far = sorted((low, high), key=abs)
    by = f"its {measure['heading']} is {more_or_less(apart)}{share}"
    sure = f"between {more_or_less(near)} and {more_or_less(far)}, with {comparison['confidence']:.0%} confidence"
    words = [f"{b} is {is_what} {a}: {by}, {sure}."]
    return words if verdict in ("better", "worse") else [*words, _would_settle(comparison, apart, high - low)]


def _would_settle(comparison: dict[str, Any], apart: float, width: float) -> str:
    """How much more data would separate an interval of this width from 0. It shrinks with the root of the data."""
    times = (width / 2 / apart) ** 2 if apart else math.inf
    count = comparison["unit_count"]
    more_s = (times - 1) * count * BLOCK_S
    if comparison["units"] == "sessions" and times < 100:
        more = counted(max(1, math.ceil((times - 1) * count)), "more recording")
    elif comparison["units"] == "blocks" and more_s <= _MOST_S:
        more = f"about {duration_text(max(60.0, more_s))} more of held-out driving"
    else:
        return "The difference is too small to be settled by a day of driving."
    return f"If they differ as much as here, {more} would settle it."


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
        """The command line, for the held-out frames or for a session."""
        words = ["bc-eval", "compare", *(as_argument(run.name) for run in _runs(a, b)), "--json"]
        if session:
            words += ["--session", as_argument(session_name(bench.folders.log("sessions", session)))]
        return words + bench.folders.flags("runs", "sessions")

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
    cards = [(card.info, card) for card in bench.cards.cards("drives") if card.info]
    newest: dict[tuple[str, str], SessionCard] = {}
    for info, card in sorted(cards, key=lambda pair: pair[0].start, reverse=True):
        newest.setdefault((info.session.get("track", ""), info.session.get("run", "")), card)
    names, roads = [run.name for run in runs], dict.fromkeys(road for road, _ in newest if road)
    pairs = [[newest.get((road, name)) for name in names] for road in roads]
    pair = [card for card in next((pair for pair in pairs if all(pair)), []) if card]
    views = bench.drives.views([card.path for card in pair])
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
