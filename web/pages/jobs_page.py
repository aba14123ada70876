"""Jobs: the forms that start them, the list, and the page of a job."""

from __future__ import annotations

from typing import Any

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from common.errors import printable
from model.runs.run_files import is_being_trained
from recorder.sources.imported_rows import AFTER_QUESTIONS
from web.errors import WebError
from web.jobs.job_forms import FORMS, form_of, suggested_sessions
from web.pages.index_page import not_taken_in, taken_in_first
from web.pages.request_values import Values, on_form
from web.pages.workbench import Workbench
from web.server.templates import command_answer, page, problem_answer


def job_routes(bench: Workbench) -> list[Route]:
    def whole(request: Request) -> Response:
        live, runs = bench.jobs.version(), bench.folders.run_folders()
        names: dict[str, Any] = {
            "sessions": suggested_sessions(bench.folders),
            "runs": sorted((printable(path.name), is_being_trained(path)) for path in runs.values()),
        }
        taken_in, is_usual = not_taken_in(bench)
        values = dict(request.query_params)
        opened = values.pop("start", "")
        is_learning = dict(names["runs"]).get(values.get("run", ""), False)
        context: dict[str, Any] = {"names": names, "opened": opened, "values": values, "is_learning": is_learning}
        context |= {"jobs": bench.jobs.all(), "taken_in": taken_in, "is_usual": is_usual}
        return page("jobs.html", live=live, forms=FORMS, **context)

    def now(request: Request) -> Response:
        """What runs now, for the head of every page."""
        return page("jobs_now.html", jobs=[job for job in bench.jobs.all() if job.is_running])

    def command(request: Request) -> Response:
        """The command that a form would run, or the problem with its values."""
        values = dict(request.query_params)
        try:
            words = form_of(values.get("form", "")).words(values, bench.folders)
        except WebError as error:
            return problem_answer(error)
        return command_answer(words)

    def start(request: Request, form_values: Values) -> Response:
        form = form_of(form_values.get("form", ""))
        values = form.named(form_values)
        words, made = form.words(values, bench.folders), form.page_of(values, bench.folders)
        first = taken_in_first(bench, form.name, values)
        job = bench.jobs.start(words, made, form.name, values, records=form.makes_session, first=first)
        return RedirectResponse(f"/jobs/{job.key}", status_code=303)

    def whole_job(request: Request) -> Response:
        live, job = bench.jobs.version(), bench.jobs.get(request.path_params["job"])
        answer = page("job.html", live=live, job=job, output=job.output())
        # "opens": the page was opened while the import ran; then the session opens by itself, unless it asks
        is_import = job.about.form == "import" and job.code == 0
        if "opens" in request.query_params and is_import and AFTER_QUESTIONS not in job.output():
            answer.headers["HX-Redirect"] = job.about.made
        return answer

    def stop(request: Request) -> Response:
        key = request.path_params["job"]
        bench.jobs.stop(key)
        return RedirectResponse(f"/jobs/{key}", status_code=303)

    return [
        Route("/jobs", whole),
        Route("/jobs", on_form(start), methods=["POST"]),
        Route("/jobs.command", command),
        Route("/jobs.now", now),
        Route("/jobs/{job}", whole_job),
        Route("/jobs/{job}/stop", stop, methods=["POST"]),
    ]
