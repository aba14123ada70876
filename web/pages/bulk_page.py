"""The stretches that a filter of the list finds in all sessions, and changes of their tags."""

from __future__ import annotations

from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common import UserError
from common.car import CAMERAS
from common.errors import printable
from recorder.topics import camera_topic
from web.errors import WebError
from web.logs.session_cards import SessionCard
from web.logs.session_stretches import not_dealt_with, stretches_of_kind, stretches_of_rows
from web.pages.sessions_page import SessionQuery, list_sessions
from web.pages.tagging import Action, Stretches, TagChange, change_tags, on_change
from web.pages.workbench import Workbench


class TagsOfLog(msgspec.Struct, forbid_unknown_fields=True):
    """Rows of the log with this key and fingerprint."""

    key: str
    log: str
    rows: Stretches


class BulkChange(msgspec.Struct, forbid_unknown_fields=True):
    """A request to add a name to rows of several logs, or to remove it."""

    action: Action
    name: str
    rows: list[TagsOfLog]


def bulk_routes(bench: Workbench) -> list[Route]:
    def stretches(request: Request) -> Response:
        """The stretches of a query that are neither excluded nor fine, in each finished log."""
        query = SessionQuery.parse(request.query_params)
        if not query.kind and not query.where:
            raise WebError("choose a kind of odd rows, or enter a condition", 422)
        listed = list_sessions(bench, query, patience_s=None)
        if listed.where_problem:
            raise WebError(listed.where_problem, 422)
        logs, problems = [], []
        for card in listed.cards:
            try:
                logs.append(_stretches(bench, card, query))
            except UserError as error:
                problems.append(f"{card.name}: {printable(str(error))}")
        return JSONResponse({"logs": [log for log in logs if log["rows"]], "problems": problems})

    def change(request: Request, requested: BulkChange) -> dict[str, object]:
        """Change the tags of each log. If one log fails, the others are changed; `notice` has the reason."""
        changed, commands, problems = [], [], []
        for log in requested.rows:
            try:
                path = bench.folders.log("sessions", log.key)
                log_change = TagChange(requested.action, requested.name, log.rows, log.log)
                done: dict[str, Any] = change_tags(bench, "sessions", path, log_change)
            except UserError as error:
                problems.append(f"{printable(log.key)}: {printable(str(error))}")
                continue
            if done["changed"]:
                changed.append({"key": log.key, "log": log.log, "rows": done["changed"]})
                commands += done["commands"]
        return {"changed": changed, "commands": commands, "notice": "; ".join(problems)}

    changes = on_change(BulkChange, change)
    return [Route("/sessions.found", stretches), Route("/sessions.tags", changes, methods=["POST"])]


def _stretches(bench: Workbench, card: SessionCard, query: SessionQuery) -> dict[str, Any]:
    with bench.logs.open(card.path) as opened:
        log = opened.log
        if log.problem:
            raise UserError("skipped, because it is unfinished")
        if query.where:
            rows = stretches_of_rows(opened, bench.searches.numbers(query.where, card.path))
        else:
            rows = stretches_of_kind(opened, bench.checks, query.kind)
        cameras = [camera for camera in CAMERAS if len(log.pictures(camera_topic(camera)).sequence)]
        return {
            "key": card.key,
            "name": card.name,
            "log": log.fingerprint,
            "version": opened.version,
            "camera": cameras[0] if cameras else "",
            "rows": not_dealt_with(rows, bench.cards.tags(card.path, log.fingerprint).tags),
        }
