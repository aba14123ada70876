"""What a filter of the list finds in all of its sessions: looked at, tagged, and undone as one."""

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
from web.logs.session_stretches import left, stretches_of_kind, stretches_of_rows
from web.pages.sessions_page import SessionQuery, kind_of, list_sessions
from web.pages.tagging import Action, Stretches, TagChange, change_tags, on_change
from web.pages.workbench import Workbench


class TagsOfLog(msgspec.Struct, forbid_unknown_fields=True):
    """Rows of the log of that key and fingerprint."""

    key: str
    log: str
    rows: Stretches


class BulkChange(msgspec.Struct, forbid_unknown_fields=True):
    """A request of the list: a name for rows of several logs, or without it."""

    action: Action
    name: str
    rows: list[TagsOfLog]


def bulk_routes(bench: Workbench) -> list[Route]:
    def found(request: Request) -> Response:
        """What a query of the list finds that is neither excluded nor fine, in each finished log."""
        query = SessionQuery.of(request.query_params)
        if not kind_of(query) and not query.where:
            raise WebError("no kind of odd rows, and no condition, is chosen in the list", 422)
        listed = list_sessions(bench, query, patience_s=None)
        if listed.where_problem:
            raise WebError(listed.where_problem, 422)
        logs, problems = [], []
        for card in listed.cards:
            try:
                logs.append(_found(bench, card, query))
            except UserError as error:
                problems.append(f"{card.name}: {printable(str(error))}")
        return JSONResponse({"logs": [log for log in logs if log["rows"]], "problems": problems})

    def change(request: Request, asked: BulkChange) -> dict[str, object]:
        """Change each log on its own: where one cannot be, the others are, and the reason is in `problems`."""
        changed, commands, problems = [], [], []
        for of_log in asked.rows:
            try:
                path = bench.folders.log("sessions", of_log.key)
                one = TagChange(asked.action, asked.name, of_log.rows, of_log.log)
                done: dict[str, Any] = change_tags(bench, "sessions", path, one)
            except UserError as error:
                problems.append(f"{printable(of_log.key)}: {printable(str(error))}")
                continue
            if done["changed"]:
                changed.append({"key": of_log.key, "log": of_log.log, "rows": done["changed"]})
                commands += done["commands"]
        return {"changed": changed, "commands": commands, "notice": "; ".join(problems)}

    changes = on_change(BulkChange, change)
    return [Route("/sessions.found", found), Route("/sessions.tags", changes, methods=["POST"])]


def _found(bench: Workbench, card: SessionCard, query: SessionQuery) -> dict[str, Any]:
    with bench.logs.open(card.path) as opened:
        log = opened.log
        if log.problem:
            raise UserError("it is unfinished, and passed over")
        if query.where:
            rows = stretches_of_rows(opened, bench.searches.numbers(query.where, card.path))
        else:
            rows = stretches_of_kind(opened, bench.checks, kind_of(query))
        cameras = [camera for camera in CAMERAS if len(log.pictures(camera_topic(camera)).sequence)]
        return {
            "key": card.key,
            "name": card.name,
            "log": log.fingerprint,
            "version": opened.version,
            "camera": cameras[0] if cameras else "",
            "rows": left(rows, bench.cards.tags(card.path, log.fingerprint).tags),
        }
