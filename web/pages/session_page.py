"""The page of a session or drive: its rows, pictures, odd stretches and tags, and the jobs of the log."""

from __future__ import annotations

import contextlib
import os
import shlex
from collections.abc import Callable, Mapping
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
from common.files import session_name
from common.stretches import stretches
from common.untrusted import whole_number
from recorder import Log, LogError
from recorder.log.known_lag import lag_path
from recorder.log.session_car import known_max_steering_deg
from recorder.log.tags import EXCLUDE, names_used, tags_path
from recorder.mcap.mcap_file import MAGIC
from recorder.rows.condition import log_columns, rows_where
from recorder.upkeep.recover import recovered_name
from web.errors import WebError, or_404
from web.folders.file_versions import version_of
from web.folders.notes import read_note
from web.folders.project_folders import Place, is_recording, key_of, shown_name
from web.logs.drive_view import COLUMNS, course_columns, drive_events, is_driven, road_of
from web.logs.open_logs import OpenLog
from web.logs.session_stretches import flag_stretches, not_learnt_stretches, shown_stretches
from web.pages.request_values import Values, on_form
from web.pages.tagging import TagChange, change_tags, on_change
from web.pages.workbench import Workbench
from web.server.templates import command_answer, page, problem_answer

_SUFFIX: Final = ".mcap"
_MAX_BYTES: Final = 200  # of a new log's name


@dataclass(frozen=True)
class LogJob:
    """A command for one log: `bc-log NAME LOG`."""

    name: str
    about: str
    made: Callable[[Path], Path] | None = None  # the log that it makes, or the first of several, by default
    is_named: bool = True  # the form names the new log; else the command does
    has_rows: bool = False
    has_others: bool = False

    @property
    def title(self) -> str:
        return self.name.capitalize()

    def words(self, new: Path, values: Values, logs: Mapping[str, Path]) -> list[str]:
        """The words after the log. `logs` are all logs of the folder, by key."""
        words: list[str] = []
        if self.has_rows:
            rows = [_row(values, "first"), _row(values, "last")]
            if rows[0] > rows[1]:
                raise WebError(f"rows {rows[0]} to {rows[1]}: the first row, then the last one", 422)
            words += ["--rows", *map(str, rows)]
        others = values.getlist("other") if self.has_others else []
        if self.has_others and not others:
            raise WebError("choose at least one other log to merge it with", 422)
        for key in others:
            reason = f"no log {key!r} next to this one; it may have been deleted, renamed or moved"
            words.append(str(or_404(logs.get(key), reason)))
        return [*words, f"--to={new}"] if self.made and self.is_named else words


def _suffixed(word: str) -> Callable[[Path], Path]:
    return lambda log: log.with_name(f"{session_name(log)}{word}{_SUFFIX}")


LOG_JOBS: Final = (
    LogJob("check", "Checks CRCs, indexes and order; finds broken and frozen pictures, and odd rows."),
    LogJob(
        "trim",
        "The selected rows become a new log. They keep their numbers.",
        _suffixed("-trimmed"),
        has_rows=True,
    ),
    LogJob(
        "split",
        "Each drive becomes a log: NAME-1, NAME-2 and so on. A drive ends at a gap of more than a second.",
        _suffixed("-1"),
        is_named=False,
    ),
    LogJob(
        "merge",
        "This log and the chosen ones after it become one new log. Its rows are numbered anew.",
        _suffixed("-merged"),
        has_others=True,
    ),
    LogJob(
        "recover",
        "Saves everything that is complete in an unfinished or damaged log to a new log.",
        recovered_name,
    ),
)


def log_job(name: str) -> LogJob:
    job = next((job for job in LOG_JOBS if job.name == name), None)
    return or_404(job, f"{name!r}: no job on a log has this name")


def command_line(
    job: LogJob, log: Path, values: Values, logs: Mapping[str, Path]
) -> tuple[list[str], Path | None]:
    """The words of the command, and the log that it makes, or the first of several; None for none. `values` are of
    the form, `logs` all logs of the folder, by key. Raises WebError for invalid values, and if a new log's name is
    taken."""
    if is_recording(log):
        raise WebError("this log is being recorded: wait until the recording has ended", 409)
    made = job.made(log) if job.made else None
    new = values.get("new", "").strip()
    if made is not None and new and job.is_named:
        made = made.with_name(_name(new))
    words = ["bc-log", job.name, str(log), *job.words(made or log, values, logs)]
    if made is not None and os.path.lexists(made):
        raise WebError(f"{printable(str(made))}: exists already; give another name, or remove it", 409)
    return words, made


def _name(text: str) -> str:
    name = text.removesuffix(_SUFFIX)
    is_name = name.isprintable() and "/" not in name and "\\" not in name and not name.startswith((".", "-"))
    if not (name and is_name and len(name.encode()) <= _MAX_BYTES):
        raise WebError(f"{printable(text[:60])!r}: expected the name of a log, such as lake-2", 422)
    return name + _SUFFIX


def _row(values: Values, field: str) -> int:
    text = values.get(field, "").strip()
    row = whole_number(text)
    if row is None:
        raise WebError(f"{field} row: expected the number of a row, not {printable(text[:20])!r}", 422)
    return row


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
        return JSONResponse(_state(bench, path, bench.logs.open(path)))

    def rows(request: Request) -> Response:
        """The `columns` of the state as float64, one after the other."""
        opened = bench.logs.open(path_of(request))
        states = opened.states
        since_s = (states.time_ns - states.time_ns[:1]) / 1e9
        columns = [states.row, since_s, states.steering, states.throttle, states.brake, states.speed_mph]
        if is_driven(opened.log.counts):
            columns += list(course_columns(opened.log, states.row))
        data = np.concatenate([column.astype("<f8") for column in columns]).tobytes()
        return Response(data, media_type="application/octet-stream")

    def where(request: Request) -> Response:
        """The stretches of rows that meet a condition, as [first, last] of their positions."""
        columns = log_columns(bench.logs.open(path_of(request)).states)
        mask = rows_where(columns, request.query_params.get("condition", ""))
        return JSONResponse(stretches(mask))

    def tags(request: Request) -> Response:
        """All tags as [first row, last row, number of the name], and the names."""
        path = path_of(request)
        opened = bench.logs.open(path)
        file_tags = bench.cards.tags(path, opened.log.fingerprint)
        names = sorted({tag.name for tag in file_tags.tags} | {EXCLUDE})
        number = {name: at for at, name in enumerate(names)}
        rows = [(tag.first_row, tag.last_row, number[tag.name]) for tag in file_tags.tags]
        return JSONResponse({"version": file_tags.version, "names": names, "tags": rows, "stale": file_tags.stale})

    def check_pictures(request: Request) -> Response:
        """The state of the check of all pictures. POST starts the check."""
        opened = bench.logs.open(path_of(request))
        log = opened.log
        start = partial(bench.checks.start, log) if request.method == "POST" else None
        return JSONResponse(
            bench.checks.work.state(log.fingerprint, lambda: bench.checks.are_checked(log) or None, start)
        )

    def names(request: Request) -> Response:
        return JSONResponse(sorted(names_used(path_of(request).parent)))

    def change(request: Request, requested: TagChange) -> dict[str, object]:
        return change_tags(bench, place, path_of(request), requested)

    def make_command(request: Request) -> Response:
        """The command that a form would run, or the problem with its values."""
        log = path_of(request)
        job = log_job(request.path_params["job"])
        try:
            words, _ = command_line(job, log, request.query_params, bench.folders.logs(place))
        except UserError as error:
            return problem_answer(error)
        return command_answer(words)

    def make(request: Request, values: Values) -> Response:
        log = path_of(request)
        job = log_job(request.path_params["job"])
        words, made = command_line(job, log, values, bench.folders.logs(place))
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
        {"job": job, "new": shown_name(job.made(log)) if job.made and job.is_named else ""}
        for job in LOG_JOBS
        if is_finished or job.name in ("check", "recover")
    ]
