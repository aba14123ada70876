"""Text of others in the Markdown that is written here."""

from __future__ import annotations

import json
import math
from typing import Any, Final

from common.errors import counted, printable

_MARKUP: Final = "\\|<>[]`*_!&#~"


def as_markdown(text: str) -> str:
    """Escape somebody else's text: it neither ends a table's cell nor becomes a link, a heading or a tag."""
    return "".join(f"\\{character}" if character in _MARKUP else character for character in printable(text))


def rendered(package: str, template: str, **values: Any) -> str:
    """A Markdown template of one of our packages. Its filter `text` is `as_markdown`, `json` quotes for YAML."""
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
    """A number of a file that is not trusted; "-" where it is none."""
    is_number = isinstance(value, int | float) and math.isfinite(value) and abs(value) < 1e9
    return f"{value:.{digits}f}" if is_number else "-"
