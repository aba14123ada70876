"""The page of a session or drive: its rows, pictures, odd stretches and tags, and the jobs of the log."""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from common import UserError
from common.car import CAMERAS
from common.errors import printable
from common.stretches import stretches
from recorder import Log, LogError
from recorder.log.known_lag import lag_path
from recorder.log.session_car import known_max_steering_deg
from recorder.log.tags import EXCLUDE, names_used, tags_path
from recorder.mcap.mcap_file import MAGIC
from recorder.rows.condition import log_columns, rows_where
from recorder.upkeep.recover import recovered_name
from web.folders.file_versions import version_of
from web.folders.notes import read_note
from web.folders.project_folders import Place, is_recording, key_of, shown_name
from web.jobs.log_jobs import LOG_JOBS, NewLogForm, command_line, log_job
from web.logs.drive_view import COLUMNS, course_columns, drive_events, is_driven, road_of
from web.logs.open_logs import OpenLog
from web.logs.session_stretches import flag_stretches, not_learnt_stretches, shown_stretches
from web.pages.request_values import Values, on_form
from web.pages.tagging import TagChange, change_tags, on_change
from web.pages.workbench import Workbench
from web.server.templates import command_answer, page, problem_answer

_COLUMNS: Final = ("row", "time_s", "steering", "throttle", "brake", "speed_mph")


def session_routes(bench: Workbench, place: Place) -> list[Route]:
    def path_of(request: Request) -> Path:
        return bench.folders.log(place, request.path_params["log"])

    def whole(request: Request) -> Response:
        path = path_of(request)
        name, at = shown_name(path), f"/{place}/{request.path_params['log']}"
        try:
            info = bench.cards.info(path)
        except LogError as error:  # damaged, or the first second of a recording
            return page("damaged.html", name=name, place=place, at=at, rescue=_rescue(path, place, str(error)))
        return page(
            "session.html",
            name=name,
            place=place,
            at=at,
            info=info,
            note=read_note(path),
            rescue=_rescue(path, place, info.notice) if info.notice else None,
            cameras=CAMERAS,
            can_train=place == "sessions" and path.suffix == ".mcap" and not info.notice,
            is_driven=is_driven(topic.topic for topic in info.topics),
            path=printable(str(path)),
            log_jobs=_shown_log_jobs(path, is_finished=not info.notice),
            others=[item for item in bench.folders.finished(place).items() if item[1] != name],
            play_command=printable(shlex.join(["bc-play", str(path)])),
            runs=[(key, printable(run.name)) for key, run in bench.folders.run_folders().items()],
        )

    def version(request: Request) -> Response:
        """The versions of the log, its tags and its lag. A page loads what has changed."""
        bench.logs.drop_changed()
        path = path_of(request)
        is_growing = is_recording(path)
        files = {"log": path, "tags": tags_path(path), "lag": lag_path(path)}
        versions = {name: version_of(file) for name, file in files.items()}
        return JSONResponse(versions | {"growing": is_growing})

    def state(request: Request) -> Response:
        path = path_of(request)
        with bench.logs.open(path) as opened:
            return JSONResponse(_state(bench, path, opened))

    def rows(request: Request) -> Response:
        """The `columns` of the state as float64, one after the other."""
        with bench.logs.open(path_of(request)) as opened:
            states = opened.states
            since_s = (states.time_ns - states.time_ns[:1]) / 1e9
            columns = [states.row, since_s, states.steering, states.throttle, states.brake, states.speed_mph]
            if is_driven(opened.log.counts):
                columns += list(course_columns(opened.log, states.row))
            data = np.concatenate([column.astype("<f8") for column in columns]).tobytes()
            return Response(data, media_type="application/octet-stream")

    def where(request: Request) -> Response:
        """The stretches of rows that meet a condition, as [first, last] of their positions."""
        with bench.logs.open(path_of(request)) as opened:
            mask = rows_where(log_columns(opened.states), request.query_params.get("condition", ""))
        return JSONResponse(stretches(mask))

    def tags(request: Request) -> Response:
        """All tags as [first row, last row, number of the name], and the names."""
        path = path_of(request)
        with bench.logs.open(path) as opened:
            file_tags = bench.cards.tags(path, opened.log.fingerprint)
        names = sorted({tag.name for tag in file_tags.tags} | {EXCLUDE})
        number = {name: at for at, name in enumerate(names)}
        rows = [(tag.first_row, tag.last_row, number[tag.name]) for tag in file_tags.tags]
        return JSONResponse({"version": file_tags.version, "names": names, "tags": rows, "stale": file_tags.stale})

    def check_pictures(request: Request) -> Response:
        """The state of the check of all pictures. POST starts the check."""
        with bench.logs.open(path_of(request)) as opened:
            log = opened.log
            start = partial(bench.checks.start, log) if request.method == "POST" else None
            return JSONResponse(
                bench.checks.work.state(log.fingerprint, lambda: bench.checks.are_checked(log) or None, start)
            )

    def names(request: Request) -> Response:
        """The names of tags in this folder."""
        return JSONResponse(sorted(names_used(path_of(request).parent)))

    def change(request: Request, requested: TagChange) -> dict[str, object]:
        return change_tags(bench, place, path_of(request), requested)

    def make_command(request: Request) -> Response:
        """The command that a form would run, or the problem with its values."""
        log = path_of(request)
        job = log_job(request.path_params["job"])
        form = _form_of(request.query_params)
        try:
            words, _ = command_line(job, log, form, bench.folders.logs(place))
        except UserError as error:
            return problem_answer(error)
        return command_answer(words)

    def make(request: Request, values: Values) -> Response:
        log = path_of(request)
        job = log_job(request.path_params["job"])
        words, made = command_line(job, log, _form_of(values), bench.folders.logs(place))
        address = f"/{place}/{key_of(made)}" if made is not None else ""
        started = bench.jobs.start(words, address)
        return RedirectResponse(f"/jobs/{started.key}", status_code=303)

    at = f"/{place}/{{log}}"
    return [
        Route(at, whole),
        Route(f"{at}/version", version),
        Route(f"{at}/state", state),
        Route(f"{at}/rows", rows),
        Route(f"{at}/where", where),
        Route(f"{at}/tags", tags),
        Route(f"{at}/names", names),
        Route(f"{at}/tags", on_change(TagChange, change), methods=["POST"]),
        Route(f"{at}/look", check_pictures, methods=["GET", "POST"]),
        Route(f"{at}/make/{{job}}/command", make_command),
        Route(f"{at}/make/{{job}}", on_form(make), methods=["POST"]),
    ]


def _state(bench: Workbench, path: Path, opened: OpenLog) -> dict[str, object]:
    """The data of a log, without its rows and tags. `course` is None for a log without commands and poses."""
    log, states = opened.log, opened.states
    findings = bench.checks.findings(log)
    has_course = is_driven(log.counts)
    events = msgspec.to_builtins(drive_events(log, states.row, states.time_ns)) if has_course else []
    return {
        "columns": [*_COLUMNS, *COLUMNS] if has_course else _COLUMNS,
        "course": {"events": events, "road": road_of(log)} if has_course else None,
        "version": opened.version,
        "lag": version_of(lag_path(path)),
        "fingerprint": log.fingerprint,
        "rows": len(states.row),
        "cameras": opened.cameras,
        "problem": printable(log.notice),  # a recovery would lose the tags of an unfinished log
        "odd": shown_stretches(log, states, findings) if len(states.row) else [],
        "flags": flag_stretches(states),
        "not_learnt": not_learnt_stretches(states),
        "max_steering_deg": _max_steering_deg(log),
        "pictures_checked": bench.checks.are_checked(log),
    }


def _max_steering_deg(log: Log) -> float | None:
    """The wheels' angle at steering 1; None if it is unknown, or differs between rows."""
    with contextlib.suppress(LogError):
        return known_max_steering_deg(log)
    return None


@dataclass(frozen=True)
class Rescue:
    """What a page says of an unfinished or damaged log that is no longer recorded."""

    why: str
    can: bool  # be recovered
    saved: str  # the page of the recovered log; "" for none yet
    saved_name: str


def _rescue(path: Path, place: Place, notice: str) -> Rescue | None:
    """None for a log that is being recorded."""
    if is_recording(path):
        return None
    why = printable(notice).removeprefix(f"{printable(str(path))}: ").partition(";")[0]
    made = recovered_name(path)
    with path.open("rb") as file:
        can = file.read(len(MAGIC)) == MAGIC
    return Rescue(
        f"{why[:1].upper()}{why[1:]}.", can, f"/{place}/{key_of(made)}" if made.is_file() else "", shown_name(made)
    )


def _shown_log_jobs(log: Path, *, is_finished: bool) -> list[dict[str, Any]]:
    """The jobs that the page of a log offers, with the default names of new logs. An unfinished log is recovered
    before anything else is made of it."""
    return [
        {
            "job": job,
            "new": shown_name(job.made(log)) if job.made and job.is_named else "",
        }
        for job in LOG_JOBS
        if is_finished or job.name in ("check", "recover")
    ]


def _form_of(values: Values) -> NewLogForm:
    new, first, last = (values.get(name, "").strip() for name in ("new", "first", "last"))
    return NewLogForm(new, first, last, tuple(values.getlist("other")))
