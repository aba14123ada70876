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
from urllib.parse import parse_qs, urlencode, urlsplit

from tests.helpers.driving import PATIENCE_S, Process
from tests.helpers.pages import TOKEN
from tests.helpers.waiting import wait_until
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
    token: str = TOKEN

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def get(self, path: str, **headers: str) -> Answer:
        return self.ask("GET", path, **headers)

    def command(self, path: str) -> str:
        """The command of a form, or what is wrong with its values."""
        return html.unescape(re.sub(r"<[^>]*>", "", self.get(path).text))

    def post(self, path: str, **values: str) -> Answer:
        """Send a form of the workbench's own pages."""
        form = {"Content_Type": "application/x-www-form-urlencoded"}
        return self.ask("POST", path, urlencode(values).encode(), **form)

    def ask(self, method: str, path: str, body: bytes | None = None, /, **headers: str) -> Answer:
        """As a program asks that is no browser, which has the token; `headers` are said as they are,
        `Sec_Fetch_Site` with dashes."""
        with self.asked(method, path, body, **headers) as answer:
            return Answer(answer.status, dict(answer.getheaders()), answer.read())

    @contextlib.contextmanager
    def asked(
        self, method: str, path: str, body: bytes | None = None, /, **headers: str
    ) -> Iterator[http.client.HTTPResponse]:
        """`ask`, of which nothing is read yet; it is broken off when the context is left."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        with contextlib.closing(connection):
            given = {name.replace("_", "-"): value for name, value in headers.items()}
            own = {"Authorization": f"Bearer {self.token}"} if self.token else {}
            connection.request(method, path, body, {**own, **given})
            with contextlib.closing(connection.getresponse()) as answer:
                yield answer


def served_by(process: Process, folder: Path) -> Served:
    """The workbench of a `bc-web` that has printed its address, opened by it."""
    process.wait_for("Ctrl-C ends it")
    address = urlsplit(wait_until(lambda: process.stdout).strip())
    (token,) = parse_qs(address.query)["token"]
    return Served(folder, address.port or 0, token)


@contextlib.contextmanager
def served(
    folder: Path,
    host: str = "127.0.0.1",
    token: str = TOKEN,
    at: Path | None = None,
    drives: Path | None = None,
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
            yield Served(folder, server.port, token)
        finally:
            server.stop()
