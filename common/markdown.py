"""Untrusted text in Markdown that the toolkit writes."""

from __future__ import annotations

import json
import math
from typing import Any, Final

from common.errors import counted, printable

_MARKUP: Final = "\\|<>[]`*_!&#~"


def as_markdown(text: str) -> str:
    """Escape untrusted text, so that it neither ends a table's cell nor becomes a link, a heading or a tag."""
    return "".join(f"\\{character}" if character in _MARKUP else character for character in printable(text))


def rendered(package: str, template: str, **values: Any) -> str:
    """Render a Markdown template of one of the toolkit's packages. Filters: `text` is `as_markdown`, `json` quotes
    for YAML."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(package),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(text=as_markdown, json=json.dumps, counted=counted, number=shown_number)
    return environment.get_template(template).render(values)


def shown_number(value: object, digits: int = 2) -> str:
    """Format a value of an untrusted file: a number with `digits` decimals, "-" if it is not a number."""
    is_number = isinstance(value, int | float) and math.isfinite(value) and abs(value) < 1e9
    return f"{value:.{digits}f}" if is_number else "-"
