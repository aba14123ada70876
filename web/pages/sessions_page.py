"""The list of sessions, the rows that its filter finds in all of them, and changes of the tags of these rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import printable
from recorder.log_cli import SORTED_BY
from recorder.rows.causes import CAUSES, PLAIN
from web.errors import WebError
from web.folders.cache_folder import PATIENCE_S
from web.index.index_view import bins_of_index
from web.logs.session_cards import IndexState, SessionCard
from web.logs.session_stretches import (
    SURE,
    not_dealt_with,
    stretches_of_kind,
    stretches_of_rows,
)
from web.pages.request_values import has_words
from web.pages.tagging import Action, Stretches, TagChange, change_tags, on_change
from web.pages.workbench import Workbench
from web.server.templates import page

SORTS: Final[dict[str, Callable[[SessionCard], Any]]] = {
    **{name: (lambda card, key=key: key(card.info)) for name, key in SORTED_BY.items() if name != "name"},  # type: ignore[misc]
    "name": lambda card: card.name,
    "most odd rows": lambda card: -card.odd_rows,
}
KINDS: Final = {
    "with surely odd rows": SURE,
    **{f"with {kind.replace('_', ' ')}": kind for kind in CAUSES if not kind.endswith("_picture")},
}
"""Choices of the list by kinds of odd rows."""
ONLY: Final[dict[str, Callable[[SessionCard], bool]]] = {
    "all": lambda card: True,
    "with odd rows": lambda card: bool(card.flags),
    "with tags": lambda card: bool(card.tags),
    "not in the index, or changed since": lambda card: card.index.state is not IndexState.INDEXED,
    "unfinished or damaged": lambda card: card.state in ("unfinished", "damaged", "recording"),
    **{name: (lambda card, kind=kind: _has_kind(card, kind)) for name, kind in KINDS.items()},  # type: ignore[misc]
}


@dataclass(frozen=True)
class SessionQuery:
    text: str
    sort: str
    only: str
    where: str

    @property
    def kind(self) -> str:
        """The kind of odd rows that the list is limited to; "" for none."""
        return KINDS.get(self.only, "")

    @classmethod
    def parse(cls, query: Mapping[str, str]) -> SessionQuery:
        """The query of an address, without invalid values."""
        sort, only = query.get("sort", "newest"), query.get("only", "all")
        return cls(
            query.get("text", "").strip(),
            sort if sort in SORTS else "newest",
            only if only in ONLY else "all",
            query.get("where", "").strip(),
        )


@dataclass(frozen=True)
class Listed:
    cards: list[SessionCard]
    total: int
    reading: int  # logs that are not read yet
    rows: dict[str, int]  # number of rows that meet the condition, by key
    searched: int | None  # number of searched logs; None without a condition
    where_problem: str


class TagsOfLog(msgspec.Struct, forbid_unknown_fields=True):
    key: str
    log: str
    rows: Stretches


class BulkChange(msgspec.Struct, forbid_unknown_fields=True):
    """A request to add a name to rows of several logs, or to remove it."""

    action: Action
    name: str
    rows: list[TagsOfLog]


def session_list_routes(bench: Workbench) -> list[Route]:
    def whole(request: Request) -> Response:
        live = bench.sessions_version()  # before the logs are read, so that later changes are noticed
        query = SessionQuery.parse(request.query_params)
        return page(
            "sessions.html",
            live=live,
            sorts=list(SORTS),
            only=[name for name in ONLY if name not in KINDS],
            kinds=list(KINDS),
            query=query,
            listed=list_sessions(bench, query),
            folder=printable(str(bench.folders.sessions)),
            bins=bins_of_index(bench.folders.index),
        )

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

    return [
        Route("/sessions", whole),
        Route("/sessions.found", stretches),
        Route("/sessions.tags", on_change(BulkChange, change), methods=["POST"]),
    ]


def list_sessions(bench: Workbench, query: SessionQuery, patience_s: float | None = PATIENCE_S) -> Listed:
    """The sessions that match the query, in its order, as far as they are read within `patience_s`; None waits for
    all."""
    cards = bench.cards.cards("sessions", patience_s)
    chosen = [card for card in cards if ONLY[query.only](card) and has_words(query.text, _words(card))]
    rows: dict[str, int] = {}
    searched: int | None = None
    problem = ""
    if query.where:
        readable: dict[Path, SessionCard] = {card.path: card for card in chosen if not card.problem}
        try:
            counts = bench.search.rows(query.where, list(readable), patience_s)
        except UserError as error:
            problem = str(error)
        else:
            searched = len(counts)
            rows = {readable[path].key: count for path, count in counts.items() if count}
            chosen = [card for card in chosen if card.key in rows]
    chosen.sort(key=lambda card: (card.info is None, SORTS[query.sort](card) if card.info else 0, card.name))
    reading = sum(card.info is None and not card.problem for card in cards)
    return Listed(chosen, len(cards), reading, rows, searched, problem)


def _stretches(bench: Workbench, card: SessionCard, query: SessionQuery) -> dict[str, Any]:
    opened = bench.logs.open(card.path)
    log = opened.log
    if log.problem:
        raise UserError("skipped, because it is unfinished")
    if query.where:
        rows = stretches_of_rows(opened, bench.search.numbers(query.where, card.path))
    else:
        rows = stretches_of_kind(opened, bench.checks, query.kind)
    return {
        "key": card.key,
        "name": card.name,
        "log": log.fingerprint,
        "version": opened.version,
        "camera": next(iter(opened.cameras), ""),
        "rows": not_dealt_with(rows, bench.cards.tags(card.path, log.fingerprint).tags),
    }


def _has_kind(card: SessionCard, kind: str) -> bool:
    if kind in PLAIN:
        return bool(card.info and (card.info.flags or {}).get(kind))
    if kind == SURE:
        return card.info is not None and any(stretch.is_sure for stretch in card.info.odd or ())
    return kind in card.flags


def _words(card: SessionCard) -> list[str]:
    metadata = [card.info.start, *card.info.session.values()] if card.info else []
    return [
        card.name,
        card.note.title,
        card.note.note,
        *card.tags,
        *card.flags,
        card.index.state,
        card.state,
        *metadata,
    ]
