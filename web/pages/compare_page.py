"""Two runs on the same frames: which is better, by how much, and how sure that is."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from common.errors import printable
from dataset.frames.frames_file import session_name
from web.errors import WebError
from web.pages.request_values import form_values
from web.pages.workbench import Workbench
from web.runs.run_comparisons import compare_command, comparison_of, is_outdated, newest_job
from web.server.templates import render


def compare_routes(bench: Workbench) -> list[Route]:
    def page(request: Request) -> Response:
        live = bench.jobs.version()
        return HTMLResponse(render("compare.html", live=live, **_context(request)))

    def body(request: Request) -> Response:
        return HTMLResponse(render("compare_body.html", **_context(request)))

    async def start(request: Request) -> Response:
        values = await form_values(request)
        asked = {name: values.get(name, "") for name in ("a", "b", "session")}
        address = f"/runs.compare?{urlencode(asked)}"
        await run_in_threadpool(_start, asked, address)
        return RedirectResponse(address, status_code=303)

    def _start(asked: dict[str, str], address: str) -> None:
        """Begin a comparison that is not under way, and not known."""
        command, runs = _command(**asked), _runs(asked["a"], asked["b"])
        job = newest_job(bench.jobs.all(), command)
        is_known = job is not None and comparison_of(job) is not None and not is_outdated(job, runs)
        if not (is_known or (job is not None and job.is_running)):
            bench.jobs.start(command, address)

    def _command(a: str, b: str, session: str) -> list[str]:
        logs = bench.folders.logs("sessions")
        if session and session not in logs:
            raise WebError(f"no session {session!r}", 404)
        return compare_command(*_runs(a, b), session_name(logs[session]) if session else "", bench.folders)

    def _runs(a: str, b: str) -> tuple[Path, Path]:
        if a == b:
            raise WebError("a comparison needs two runs: choose a second one", 422)
        return bench.folders.run(a), bench.folders.run(b)

    def _context(request: Request) -> dict[str, Any]:
        asked = {name: request.query_params.get(name, "") for name in ("a", "b", "session")}
        runs = _runs(asked["a"], asked["b"])
        command = _command(**asked)
        job = newest_job(bench.jobs.all(), command)
        found = None if job is None else comparison_of(job)
        return {
            **asked,
            "names": [printable(run.name) for run in runs],
            "query": urlencode(asked),
            "sessions": bench.folders.finished("sessions"),
            "command": printable(shlex.join(command)),
            "job": job,
            "found": found,
            "is_outdated": found is not None and job is not None and is_outdated(job, runs),
        }

    return [
        Route("/runs.compare", page),
        Route("/runs.compare", start, methods=["POST"]),
        Route("/runs.compare.body", body),
    ]
