"""The jobs of a log: check, trim, split, merge and recover. The page shows their commands."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import printable
from common.location import Location
from web.folders.project_folders import Place, key_of, shown_name
from web.jobs.log_jobs import NewLogForm, command_line, jobs_for, log_job
from web.pages.request_values import Values, on_form
from web.pages.workbench import Workbench


def log_job_routes(bench: Workbench, place: Place) -> list[Route]:
    def command(request: Request) -> Response:
        """The command that a form would run, or the problem with its values."""
        log = bench.folders.log(place, request.path_params["log"])
        job = log_job(request.path_params["job"])
        form = _form_of(request.query_params)
        try:
            words, _ = command_line(job, log, form, bench.folders.logs(place), bench.folders)
        except UserError as error:
            return PlainTextResponse(printable(str(error)))
        return PlainTextResponse(printable(shlex.join(words)))

    def start(request: Request, values: Values) -> Response:
        log = bench.folders.log(place, request.path_params["log"])
        job = log_job(request.path_params["job"])
        words, made = command_line(job, log, _form_of(values), bench.folders.logs(place), bench.folders)
        address = f"/{place}/{key_of(made)}" if made is not None else ""
        started = bench.jobs.start(words, address)
        return RedirectResponse(f"/jobs/{started.key}", status_code=303)

    at = f"/{place}/{{log}}/make/{{job}}"
    return [Route(f"{at}/command", command), Route(at, on_form(start), methods=["POST"])]


def shown_log_jobs(log: Location) -> list[dict[str, Any]]:
    """The jobs that the page of a log offers, with the default names of new logs."""
    return [
        {
            "job": job,
            "new": shown_name(job.made(log)) if job.made and job.is_named and isinstance(log, Path) else "",
        }
        for job in jobs_for(log)
    ]


def _form_of(values: Values) -> NewLogForm:
    new, first, last = (values.get(name, "").strip() for name in ("new", "first", "last"))
    return NewLogForm(new, first, last, tuple(values.getlist("other")))
