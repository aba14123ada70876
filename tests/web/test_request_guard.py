"""Who may ask the workbench: nobody without the token, and no page of another site."""

from __future__ import annotations

import gzip
import os
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.helpers.driving import Process, command
from tests.helpers.logs import write_log
from tests.helpers.pages import TOKEN
from tests.helpers.ports import free_ports
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, plain, served, served_by
from web.server.templates import STATIC

FROM_OUR_PAGE = {"Sec_Fetch_Site": "same-origin", "Sec_Fetch_Mode": "cors", "Sec_Fetch_Dest": "empty"}
FROM_ANOTHER = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors", "Sec_Fetch_Dest": "image"}
TYPED = {"Sec_Fetch_Site": "none", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "document"}
A_LINK = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "document"}
A_FRAME = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "iframe"}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("bench")
    write_log(folder / "sessions" / "a.mcap", [0.1, 0.2, 0.3])
    with served(folder) as server:
        yield server


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8080",
        "127.0.0.1.evil.example",
        "evil.example@127.0.0.1",
        "[::1].evil.example",
        "",
        "a b",
    ],
)
def test_a_name_that_leads_here_but_is_not_ours_is_refused(bench: Served, host: str) -> None:
    """DNS rebinding: the page of evil.example asks evil.example, which now is this machine."""
    assert bench.get("/sessions", Host=host).status in (400, 403)


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://localhost:3000", "http://127.0.0.1", "https://127.0.0.1"],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_page_from_elsewhere_cannot_ask(bench: Served, origin: str, method: str) -> None:
    """Also not one of another program on this machine."""
    answer = bench.ask(
        method, "/sessions", b"{}" if method == "POST" else None, Origin=origin.format(port=bench.port)
    )
    assert answer.status == 403
    assert "only the workbench's own pages" in answer.json["error"]


def test_what_browsers_send_without_an_origin_is_heard_too(bench: Served) -> None:
    """A picture or a frame in another site's page has no Origin."""
    requests = [FROM_OUR_PAGE, TYPED, A_LINK, FROM_ANOTHER, A_FRAME, {**A_LINK, "Sec_Fetch_Site": "same-site"}]
    assert [bench.get("/sessions", **headers).status for headers in requests] == [200, 200, 403, 403, 403, 403]
    own = bench.address
    for scheme in ("http", "https"):  # as it is opened through a proxy that encrypts
        origin = own.replace("http", scheme)
        assert bench.get("/sessions", Origin=origin, **FROM_OUR_PAGE).status == 200


def test_no_answer_lets_code_in_or_may_be_framed(bench: Served) -> None:
    for path in ("/sessions", f"{STATIC}/js/live.js", "/nothing", "/sessions/a/pictures/center/0"):
        headers = {name.lower(): value for name, value in bench.get(path).headers.items()}
        policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
        assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == "'self'"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.parametrize(
    "path",
    [
        "/sessions/..%2f..%2fsecret/strip.jpg",
        "/sessions/%2e%2e/strip.jpg",
        "/sessions/../../secret",
        f"{STATIC}/../app.py",
        f"{STATIC}/%2e%2e/app.py",
        f"{STATIC}/..%2fapp.py",
        "/runs/secret/strip.jpg",
        "/sessions/secret/strip.jpg",
        "/sessions/a%00/strip.jpg",
        "/sessions/a/pictures/..%2fcenter/0",
        "//evil.example/sessions",
    ],
)
def test_no_path_leaves_the_folders(bench: Served, path: str) -> None:
    write_log(bench.folder / "secret.mcap", [0.1], overwrite=True)
    assert bench.get(path).status == 404


def test_a_large_body_or_one_of_unknown_length_is_refused(bench: Served) -> None:
    assert bench.ask("POST", "/sessions", b"x" * (1 << 20 | 1)).status == 413
    assert bench.ask("POST", "/sessions", None, Transfer_Encoding="chunked").status in (400, 411)
    chunk = b"2\r\n{}\r\n0\r\n\r\n"  # its length counts, not that of the head
    assert bench.ask("POST", "/sessions", chunk, Content_Length="2", Transfer_Encoding="chunked").status == 411


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_everything_needs_the_token(tmp_path: Path, host: str) -> None:
    """Also on loopback, which every user of this machine reaches. The files of the pages are the toolkit's own."""
    write_log(tmp_path / "sessions" / "a.mcap", [0.1])
    with served(tmp_path, host) as bench:
        nobody = Served(tmp_path, bench.port, token="")
        own = f"bc-web-{bench.port}"
        for path in ("/", "/sessions", "/changes", "/sessions/a/strip.jpg", "/nothing"):
            assert nobody.get(path).status == 401
            for cookie in (f"{own}={bench.token[:-1]}", f"{own}=", f"bc-web-1={bench.token}"):
                assert nobody.get(path, Cookie=cookie).status == 401
            assert nobody.get(f"{path}?token=the-tokeN").status == 401
            assert nobody.post(path).status == 401
        assert "open the address that bc-web printed" in plain(nobody.get("/", Accept="text/html").text)
        assert nobody.get(f"{STATIC}/css/workbench.css").status == 200
        assert bench.get("/sessions").status == 200


def test_the_printed_address_is_exchanged_for_a_cookie(bench: Served) -> None:
    nobody = Served(bench.folder, bench.port, token="")
    answer = nobody.get(f"/sessions?token={TOKEN}&sort=name")
    assert (answer.status, answer.headers["location"]) == (303, "/sessions?sort=name")
    own, *attributes = answer.headers["set-cookie"].lower().split("; ")
    assert {"httponly", "samesite=strict"} <= set(attributes)
    assert own == f"bc-web-{bench.port}={TOKEN}"  # browsers send the cookies of all ports of a host
    for others in ("", 'of-another-port={"a": 1}; ', "a b=1; ", "=x; ", "bc-web-1=other; "):
        assert nobody.get("/sessions", Cookie=f"{others}{own}").status == 200
    assert nobody.get(f"//evil.example/?token={TOKEN}").headers["location"].startswith("/evil.example")


def test_the_command_reports_where_it_listens_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    (port,) = free_ports(1)
    with Process(command("bc-web", "--port", port, "--host", "127.0.0.1"), cwd=tmp_path) as process:
        assert served_by(process, tmp_path).get("/sessions").status == 200
        assert Served(tmp_path, port, token="").get("/sessions").status == 401
        with Process(command("bc-web", "--port", port), cwd=tmp_path) as second:
            assert second.join() == 1
        assert [line for line in second.stderr if "give another --port" in line]
        assert process.end() == 0
    assert re.fullmatch(rf"http://127\.0\.0\.1:{port}/\?token=[\w-]{{32}}\n", process.stdout)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="the browser is a shell script")
def test_the_address_in_the_command_line_of_the_browser_opens_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other users see command lines."""
    browser, opened = tmp_path / "browser", tmp_path / "opened"
    browser.write_text(f'#!/bin/sh\necho "$1" > {opened}.part && mv {opened}.part {opened}\n')
    browser.chmod(0o700)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with Process(command("bc-web", "--port", *free_ports(1), "--open"), cwd=tmp_path) as process:
        bench = served_by(process, tmp_path)
        address = wait_until(lambda: opened.read_text().strip() if opened.exists() else "")
        assert address.startswith(f"{bench.address}/?token=")
        assert bench.token not in address
        nobody = Served(tmp_path, bench.port, token="")
        path = address.removeprefix(bench.address)
        answer = nobody.get(path)
        assert answer.status == 303
        cookie = answer.headers["set-cookie"].partition(";")[0]
        assert nobody.get("/sessions", Cookie=cookie).status == 200
        assert nobody.get(path, Cookie=cookie).status == 200  # the same browser may ask twice
        again = nobody.get(path)  # as a browser that another user was faster than
        assert (again.status, "another user of this machine did: end bc-web" in again.text) == (401, True)


def test_without_a_token_other_users_are_let_in_but_no_other_site(tmp_path: Path) -> None:
    with Process(command("bc-web", "--no-token", "--host", "0.0.0.0"), cwd=tmp_path) as refused:
        assert refused.join() == 2
    assert ["--no-token" in line for line in refused.stderr] == [True]
    with Process(command("bc-web", "--port", *free_ports(1), "--no-token"), cwd=tmp_path) as process:
        process.wait_for("Ctrl-C ends it")
        address = urlsplit(wait_until(lambda: process.stdout).strip())
        bench = Served(tmp_path, address.port or 0, token="")
        assert address.geturl() == f"{bench.address}/"
        assert bench.get("/sessions").status == 200
        for path in ("/", "/sessions?where=speed_mph>5"):
            answer = bench.get(path, Accept="text/html", **A_LINK)
            assert answer.status == 403
            assert 'href="/sessions"' in answer.text


def test_files_of_the_pages_are_kept_by_browsers_and_sent_small(bench: Served) -> None:
    """At an address that changes with their content; what changes without it is kept by nobody."""
    answer = bench.get(f"{STATIC}/css/workbench.css", Accept_Encoding="gzip")
    assert "immutable" in answer.headers["cache-control"]
    assert answer.headers["content-encoding"] == "gzip"
    assert gzip.decompress(answer.body) == bench.get(f"{STATIC}/css/workbench.css").body
    assert STATIC in bench.get("/sessions").text
    assert bench.get("/sessions").headers["cache-control"] == "no-store"
    assert bench.get("/sessions", Accept_Encoding="gzip").headers["content-encoding"] == "gzip"
