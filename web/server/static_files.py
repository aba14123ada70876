"""The files of the pages. Their address changes with them, so that a browser may keep them for ever."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, Final

from starlette.responses import Response
from starlette.staticfiles import StaticFiles

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
    """Everything under web/static."""

    def __init__(self) -> None:
        super().__init__(directory=FOLDER)

    def file_response(self, *arguments: Any, **named: Any) -> Response:
        answer = super().file_response(*arguments, **named)
        answer.headers.update(KEPT)
        return answer
