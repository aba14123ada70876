"""The workbench on a free port, in this process, and plain requests to it."""

from __future__ import annotations

import contextlib
import html
import http.client
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from common.location import Location
from driving import PATIENCE_S
from web.app import workbench_app
from web.folders.project_folders import ProjectFolders
from web.server.workbench_server import WorkbenchServer


def plain(page: str) -> str:
    """The text of a page, or of a part of it, without its elements."""
    return html.unescape(" ".join(re.sub(r"<[^>]*>", " ", page).split()))


@dataclass(frozen=True)
class Answer:
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class Served:
    """A workbench that answers on `port`."""

    folder: Path
    port: int

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def get(self, path: str, **headers: str) -> Answer:
        return self.ask("GET", path, **headers)

    def post(self, path: str, **values: str) -> Answer:
        """Send a form of the workbench's own pages."""
        form = {"Content_Type": "application/x-www-form-urlencoded"}
        return self.ask("POST", path, urlencode(values).encode(), **form)

    def ask(self, method: str, path: str, body: bytes | None = None, /, **headers: str) -> Answer:
        """As a program asks that is no browser; `headers` are said as they are, `Sec_Fetch_Site` with dashes."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        with contextlib.closing(connection):
            said = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, body, said)
            answer = connection.getresponse()
            return Answer(answer.status, dict(answer.getheaders()), answer.read())


@contextlib.contextmanager
def served(
    folder: Path,
    host: str = "127.0.0.1",
    token: str = "",
    at: Location | None = None,
    drives: Location | None = None,
    port: int = 0,
) -> Iterator[Served]:
    """The workbench over the folders of a project, which is `at` another place if one is given, as may be its
    `drives` alone; its cache is in `folder`. It listens on loopback, whatever it believes its `host` to be, on a
    free port unless one is given."""
    within = at or folder
    folders = ProjectFolders(within / "sessions", within / "index", within / "runs", drives or within / "drives")
    with workbench_app(folders, host, token, folder / "cache") as app:
        server = WorkbenchServer(app, "127.0.0.1", port)
        server.start()
        try:
            yield Served(folder, server.port)
        finally:
            server.stop()
