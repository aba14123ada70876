"""The templates: all values are escaped, because names and tags come from untrusted files. And the files of the
pages: their address changes with them, so that a browser may keep them for ever."""

from __future__ import annotations

import hashlib
import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from starlette.responses import HTMLResponse, Response
from starlette.staticfiles import StaticFiles

from common.errors import counted, decimal, printable
from common.versions import version_of
from web.jobs.exports import LOG_EXPORTS, RUN_EXPORTS

KEPT: Final = {"Cache-Control": "private, max-age=31536000, immutable"}
"""For answers whose address names their content."""
FOLDER: Final = Path(__file__).parents[1] / "static"


def _digest() -> str:
    content = hashlib.sha256()
    for path in sorted(FOLDER.rglob("*")):
        if path.is_file():
            content.update(f"{path.relative_to(FOLDER)}\0{path.stat().st_size}\0".encode())
            content.update(path.read_bytes())
    return content.hexdigest()[:16]


STATIC: Final = f"/static/{_digest()}"


class PageFiles(StaticFiles):
    def __init__(self) -> None:
        super().__init__(directory=FOLDER)

    def file_response(self, *arguments: Any, **named: Any) -> Response:
        answer = super().file_response(*arguments, **named)
        answer.headers.update(KEPT)
        return answer


PAGES: Final = (
    ("Drive", "/wheel"),
    ("Recordings", "/sessions"),
    ("Networks", "/runs"),
    ("Test drives", "/drives"),
)
"""The menu: names and addresses."""
_SHORT: Final = 34  # characters


def _minutes(seconds: float) -> str:
    """12 min 5 s as "12:05"; an hour and more as "1:02:05"."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"


def _places(number: float | str | None, places: int) -> str:
    """A number with `places` decimal places; "-" for None. A text that is no number stays."""
    if number is None:
        return "-"
    try:
        value = float(number)
    except ValueError:
        return str(number)
    if abs(value) < 1e6:
        return f"{value:,.{places}f}"
    return decimal(value, places) if math.isfinite(value) else "-"


def _when(utc: str) -> Markup:
    """A time in ISO 8601, in UTC, to the minute; the page shows it in the browser's time zone (live.js)."""
    if not utc:
        return Markup()
    minute = utc[:16]
    return Markup('<time datetime="{}Z">{} UTC</time>').format(minute, minute.replace("T", " "))


def short(name: str) -> Markup:
    """A name for a list: a long one is cut in the middle, and whole when the mouse points at it."""
    if len(name) <= _SHORT:
        return escape(name)
    return Markup('<span title="{}">{}…{}</span>').format(name, name[: _SHORT // 2], name[-_SHORT // 2 + 1 :])


def with_code(text: str) -> Markup:
    """A text, escaped, in which the parts between backticks are code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def command_answer(words: Sequence[str]) -> HTMLResponse:
    """The answer to a form that asks for its command: the command, for those who want to see it."""
    return HTMLResponse(Markup('<span class="command">{}</span>').format(printable(shlex.join(words))))


def problem_answer(error: Exception) -> HTMLResponse:
    """The answer to a form that asks for its command, if its values are wrong."""
    return HTMLResponse(Markup('<span class="problem">{}</span>').format(printable(str(error))))


_environment = Environment(
    loader=PackageLoader("web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)
_environment.globals.update(menu=PAGES, static=STATIC, version=version_of())
_environment.globals.update(log_exports=LOG_EXPORTS, run_exports=RUN_EXPORTS)
_environment.filters.update(
    minutes=_minutes, counted=counted, places=_places, with_code=with_code, when=_when, short=short
)


def page(template: str, /, **values: Any) -> HTMLResponse:
    return HTMLResponse(_environment.get_template(template).render(values))
