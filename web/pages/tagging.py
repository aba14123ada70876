"""Naming rows of a log from the page: by the functions of `bc-log tag`, which appends to a file beside it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Literal

import msgspec
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from common.errors import did_you_mean, printable
from common.location import Location
from recorder.log.tags import EXCLUDE, FINE, Tag, add_tag, check_name, names_used, remove_tag, tags_path
from recorder.upkeep.edit import check_rows
from web.data.project_folders import Place
from web.errors import WebError
from web.pages.workbench import Workbench


class TagChange(msgspec.Struct, forbid_unknown_fields=True):
    """A request of a page: to add a name to rows of the log with that fingerprint, or to remove it."""

    action: Literal["add", "remove"]
    name: str
    rows: tuple[int, int]
    log: str


async def change_tags(bench: Workbench, place: Place, path: Location, request: Request) -> Response:
    # no form of another page can send this type unasked
    if request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise WebError("a change of tags is sent as application/json", 415)
    try:
        change = msgspec.json.decode(await request.body(), type=TagChange)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise WebError(f"not a change of tags: {error}", 422) from None
    return JSONResponse(await run_in_threadpool(_changed, bench, place, path, change))


def _changed(bench: Workbench, place: Place, path: Location, change: TagChange) -> dict[str, object]:
    """Make the change; what was done, as the command that does the same."""
    try:
        check_name(change.name)
    except ValueError as error:
        raise WebError(str(error), 422) from None
    if change.name.startswith("-"):
        raise WebError(f"{change.name}: a command would take it for a flag; choose another name", 422)
    if not 0 <= change.rows[0] <= change.rows[1]:
        raise WebError(f"rows {change.rows[0]} to {change.rows[1]}: the first row, then the last one", 422)
    with bench.logs.open(path) as opened:
        if opened.log.problem:
            raise WebError(f"{opened.log.notice}; tag that one", 409)
        if opened.log.fingerprint != change.log:
            raise WebError("the log has been replaced since this page was opened: reload it", 409)
        check_rows(opened.log, change.rows)
    tag = Tag(*change.rows, change.name)
    is_add = change.action == "add"
    there = set(bench.cards.tags(path, change.log).tags)
    if (tag in there) == is_add:
        return {"changed": False, "command": "", "notice": ""}
    notice = _notice(change.name, there, names_known(bench, place, path)) if is_add else ""
    (add_tag if is_add else remove_tag)(path, change.log, tag)
    bench.folders.refresh_object(tags_path(path))
    return {"changed": True, "command": command_of(path, change), "notice": notice}


def names_known(bench: Workbench, place: Place, path: Location) -> set[str]:
    """The names that tags have in the folder of a log; EXCLUDE and FINE are always among them. In a
    store, those of the logs that were read by now: each file of tags would be a request."""
    if isinstance(path, Path):
        return names_used(path.parent)
    return {EXCLUDE, FINE}.union(*(card.tags for card in bench.cards.cards(place, 0)))


def _notice(name: str, there: set[Tag], used: set[str]) -> str:
    """A notice about a name that is not in use yet: it may be mistyped."""
    if any(tag.name == name for tag in there):
        return ""
    return "" if name in used else f"new tag {name!r}. {did_you_mean(name, used)}".strip()


def command_of(path: Location, change: TagChange) -> str:
    words = ["bc-log", "tag", str(path), change.name, "--rows", *map(str, change.rows)]
    return printable(shlex.join([*words, "--remove"] if change.action == "remove" else words))
