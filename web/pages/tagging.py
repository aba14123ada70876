"""Changes of tags, by the functions of `bc-log tag`."""

from __future__ import annotations

import shlex
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import msgspec
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from common.errors import did_you_mean, printable
from recorder.log.tags import Tag, add_tags, check_name, names_used, remove_tags
from recorder.upkeep.edit import check_rows
from web.errors import WebError
from web.folders.project_folders import Place
from web.jobs.job_forms import as_argument
from web.pages.workbench import Workbench

Rows = tuple[int, int]
Stretches = Annotated[list[Rows], msgspec.Meta(min_length=1)]
Action = Literal["add", "remove"]
Change = TypeVar("Change", bound=msgspec.Struct)


class TagChange(msgspec.Struct, forbid_unknown_fields=True):
    """A request to add a name to rows of a log, or to remove it."""

    action: Action
    name: str
    rows: Stretches
    log: str  # its fingerprint


def on_change(
    kind: type[Change], change: Callable[[Request, Change], dict[str, object]]
) -> Callable[[Request], Awaitable[Response]]:
    """The endpoint that calls `change` with the body of a request, on a thread."""

    async def endpoint(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(change, request, await _json_of(request, kind)))

    return endpoint


async def _json_of(request: Request, kind: type[Change]) -> Change:
    """The body of a request. Raises WebError for any other body."""
    # forms of other sites cannot send this type
    if request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise WebError("a change of tags is sent as application/json", 415)
    try:
        return msgspec.json.decode(await request.body(), type=kind)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise WebError(f"not a change of tags: {error}", 422) from None


def change_tags(bench: Workbench, place: Place, path: Path, change: TagChange) -> dict[str, object]:
    """Make all of a change, or nothing. Return the changed stretches, and the commands that do the same. Raises
    WebError, LogError."""
    try:
        check_name(as_argument(change.name))
    except ValueError as error:
        raise WebError(str(error), 422) from None
    for first, last in change.rows:
        if not 0 <= first <= last:
            raise WebError(f"rows {first} to {last}: the first row, then the last one", 422)
    opened = bench.logs.open(path)
    if opened.log.problem:
        raise WebError(f"{opened.log.notice}; tag that one", 409)
    if opened.log.fingerprint != change.log:
        raise WebError("the log has been replaced since this page was opened: reload it", 409)
    check_rows(opened.log, (min(first for first, _ in change.rows), max(last for _, last in change.rows)))
    before = set(bench.cards.tags(path, change.log).tags)
    is_add = change.action == "add"
    requested = dict.fromkeys(Tag(*rows, change.name) for rows in change.rows)
    tags = [tag for tag in requested if (tag in before) != is_add]
    if not tags:
        return {"changed": [], "commands": [], "notice": ""}
    notice = _notice(change.name, before, names_used(path.parent)) if is_add else ""
    (add_tags if is_add else remove_tags)(path, change.log, tags)
    return {
        "changed": [tag[:2] for tag in tags],
        "commands": [_command(path, tag, change.action) for tag in tags],
        "notice": notice,
    }


def _notice(name: str, tags: set[Tag], names: set[str]) -> str:
    """A notice about a new name, which may be mistyped."""
    if name in names or any(tag.name == name for tag in tags):
        return ""
    return f"new tag {name!r}. {did_you_mean(name, names)}".strip()


def _command(path: Path, tag: Tag, action: Action) -> str:
    words = ["bc-log", "tag", str(path), tag.name, "--rows", str(tag.first_row), str(tag.last_row)]
    return printable(shlex.join([*words, "--remove"] if action == "remove" else words))
