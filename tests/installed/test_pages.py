"""Every page and button of bc-web, as the README's line installs it."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urljoin, urlsplit

import pytest
from starlette.routing import Match, Route, WebSocketRoute

from tests.helpers.installed_toolkit import Toolkit
from tests.helpers.ports import free_ports
from tests.helpers.upload_bodies import upload_body
from tests.helpers.waiting import PATIENCE_S, wait_until
from tests.helpers.wheel_page import WheelPage
from tests.helpers.workbench import Answer, Served
from web.app import routes_of
from web.folders.project_folders import ProjectFolders
from web.pages.workbench import Workbench

LINK: Final = re.compile(r'(?:href|src|hx-get)="(/[^"#]*)"')


class User:
    """Somebody in a browser: follows links, presses buttons, and waits for jobs."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.seen: set[tuple[str, str]] = set()

    def get(self, path: str, **headers: str) -> Answer:
        self.seen.add(("GET", path))
        answer = self.served.get(path, **headers)
        assert answer.status in (200, 204, 303, 307), (path, answer.status, answer.body[:500])
        return answer

    def press(self, path: str, **values: str) -> str:
        """Where a button leads."""
        self.seen.add(("POST", path))
        answer = self.served.post(path, **values)
        assert answer.status in (200, 204, 303), (path, answer.status, answer.body[:500])
        return answer.headers.get("location", "")

    def send(self, path: str, value: object) -> Any:
        self.seen.add(("POST", path))
        answer = self.served.ask("POST", path, json.dumps(value).encode(), Content_Type="application/json")
        assert answer.status == 200, (path, answer.status, answer.body)
        return answer.json

    def do(self, path: str, **values: str) -> str:
        """Press a button that starts a job, and wait until the job has succeeded. Returns its page."""
        address = self.press(path, **values)
        assert address.startswith("/jobs/"), address
        wait_until(lambda: f"{address}/stop" not in self.get(address).text)
        page = self.get(address).text
        assert 'class="state good"' in page, page
        return page

    def work(self, path: str) -> Any:
        """Ask for work that a page shows when it is done."""
        self.press(path)
        wait_until(lambda: self.get(path).json["about"] is not None)
        return self.get(path).json

    def walk(self, start: str) -> None:
        """Open the pages and files to which pages link; of those that differ by numbers only, the first two."""
        left = [start]
        opened: Counter[str] = Counter()
        while left:
            path = left.pop()
            kind = re.sub(r"[0-9a-f-]*[0-9][0-9a-f-]*", "N", path)
            opened[kind] += 1
            if ("GET", path) in self.seen or opened[kind] > 2:
                continue
            answer = self.get(path)
            if "text/html" in answer.headers.get("content-type", ""):
                left += [link.replace("&amp;", "&") for link in LINK.findall(answer.text)]
            if location := answer.headers.get("location"):
                left.append(urlsplit(urljoin(path, location)).path)


@pytest.fixture(scope="module")
def user(made: Toolkit) -> Iterator[User]:
    (port,) = free_ports(1)
    with made.start("bc-web", "--port", port) as process:
        try:
            assert process.stdout is not None
            address = urlsplit(process.stdout.readline().strip())
            (token,) = parse_qs(address.query)["token"]
            yield User(Served(made.folder, port, token))
        finally:
            process.terminate()
            _, errors = process.communicate(timeout=PATIENCE_S)
            assert "Traceback" not in errors, errors


def test_pages_lead_to_pages_that_open(user: User) -> None:
    user.walk("/")
    assert user.get("/changes").json["sessions"]


def test_a_session_is_looked_at_and_cleaned(user: User) -> None:
    at = "/sessions/lake"
    for part in ("version", "state", "rows", "tags", "names", "links", "strip.jpg", "steering.svg"):
        user.get(f"{at}/{part}")
    user.get(f"{at}/where?condition=speed_mph+%3C+5+and+throttle+%3E+0")
    fingerprint = user.get(f"{at}/state").json["fingerprint"]
    for camera in ("center", "left", "right"):
        assert user.get(f"{at}/pictures/{camera}/3").body.startswith(b"\xff\xd8")
    change = {"action": "add", "name": "exclude", "rows": [[3, 9]], "log": fingerprint}
    assert user.send(f"{at}/tags", change)["changed"] == [[3, 9]]
    user.press(f"{at}/look")
    wait_until(lambda: user.get(f"{at}/look").json["about"])
    user.get(f"{at}/make/trim/command?first=0&last=9&new=lake-cut")
    user.do(f"{at}/make/trim", first="0", last="9", new="lake-cut")
    found = user.get("/sessions.found?where=speed_mph+%3C+5").json["logs"]
    rows = [{"key": log["key"], "log": log["log"], "rows": log["rows"]} for log in found]
    user.send("/sessions.tags", {"action": "add", "name": "slow", "rows": rows})


def test_what_a_network_would_have_steered_and_where_it_looked(user: User) -> None:
    at = "/sessions/lake"
    fingerprint = user.get(f"{at}/state").json["fingerprint"]
    about = user.work(f"{at}/predictions/first?log={fingerprint}")
    assert user.get(f"{at}/predictions/rows/{about['key']}").body
    user.press(f"{at}/predictions/first/stop?log={fingerprint}")
    assert user.get(f"{at}/attention/first/3").body.startswith(b"\x89PNG")


def test_pictures_that_are_alike(user: User) -> None:
    of = "of=sessions/lake&run=first"
    user.get(f"/map?{of}")
    about = user.work(f"/map.state?{of}")
    assert user.get(f"/map.points?key={about['key']}").body
    user.press(f"/map.stop?key={about['key']}")


def test_rerun_opens_in_the_page(user: User) -> None:
    for log in ("/sessions/lake", "/drives/run"):
        user.seen.add(("POST", f"{log}/rerun"))
        with user.served.asked("POST", f"{log}/rerun", b"", Content_Type="application/json") as lines:
            first = json.loads(lines.readline())
            assert "frame" in first, first
            frame = user.get(first["frame"]).text
            user.seen.add(("GET", f"{first['frame']}/log.rrd"))
            with user.served.asked("GET", f"{first['frame']}/log.rrd") as recording:
                assert recording.read(4) == b"RRF2"
            for name in re.findall(r"/rerun/files/[\w.]+", frame):
                user.get(name)
            user.get("/rerun/files/re_viewer_bg.wasm")


def test_the_index_is_looked_at_and_tried_with_other_settings(user: User) -> None:
    for part in (".altered", ".altered/0/0.jpg", ".altered/0/1.jpg", ".bins", ".leaks"):
        user.get(f"/index{part}")
    for part in ("bins", "split", "held-out"):
        user.get(f"/index/lake/{part}")
    user.do("/index.try", sessions="lake mountain", bins="15")


def test_forms_start_commands(user: User, made: Toolkit) -> None:
    user.get("/jobs.command?form=record&name=short&laps=0.01")
    user.do("/jobs", form="record", name="short", laps="0.01")
    user.do("/jobs", form="index", sessions="lake mountain")
    user.do("/jobs", form="train", name="second", network="small", epochs="1")
    user.do("/jobs", form="resume", run="second", epochs="2")
    user.do("/jobs", form="evaluate", run="second")
    user.do("/jobs", form="drive", run="second", track="lake", laps="0.01")
    user.get("/runs.curves")
    user.walk("/runs/second")
    user.press("/runs.compare", a="first", b="second")
    user.get("/runs.compare?a=first&b=second&session=")
    address = user.press("/jobs", form="import", name="imported", source=str(made.folder / "recording"))
    wait_until(lambda: f"{address}/stop" not in user.get(address).text)
    (made.folder / "sessions" / "imported.mcap").rename(
        made.folder / "imported.mcap"
    )  # it is the session lake again
    address = user.press("/jobs", form="demo")
    user.press(f"{address}/stop")


def test_a_recording_is_exported_and_titles_and_notes_are_kept(user: User) -> None:
    for at in ("/sessions/lake", "/runs/first"):
        for title in ("half a lap", ""):
            user.press(f"{at}/note", title=title, note=title)
    (download,) = re.findall(r'href="(/exports/[^"]+)"', user.do("/sessions/lake/export/udacity"))
    assert user.get(download).body.startswith(b"PK")
    assert user.get("/sessions/lake/mcap").body
    user.seen.add(("POST", "/runs/first/export/onnx"))
    assert user.served.post("/runs/first/export/onnx").status in (303, 501)  # 501: without the extra


def test_a_folder_is_browsed_and_a_recording_uploaded(user: User, made: Toolkit) -> None:
    user.get(f"/import.at?source={made.folder}")
    data = (made.folder / "sessions" / "lake.mcap").read_bytes()
    page = upload(user, {"sent.mcap": data})
    user.get(page)
    (source,) = re.findall(r'name="source" value="([^"]+)"', user.get(page).text)
    assert user.press(f"{page}/take", source=source, name="sent") == "/sessions/sent"
    page = upload(user, {"again.mcap": data})
    user.press(f"{page}/all")
    user.press(f"{page}/remove")


def upload(user: User, files: dict[str, bytes]) -> str:
    body, manifest = upload_body(files)
    path = f"/import.upload?manifest={manifest}"
    user.seen.add(("POST", path))
    answer = user.served.ask("POST", path, body)
    assert answer.status == 200, answer.body
    return str(answer.json["page"])


def test_somebody_takes_the_wheel(user: User) -> None:
    begin = user.press("/wheel", name="mine", driver="me", track="lake")
    at = wait_until(lambda: user.get(begin).headers.get("location", ""))
    user.get("/wheel.rows")
    user.get(at)
    user.seen.add(("GET", f"{at}/socket"))
    headers = {"Authorization": f"Bearer {user.served.token}", "Origin": user.served.address}
    address = f"ws://127.0.0.1:{user.served.port}{at}/socket"
    with WheelPage(address=address, headers=headers) as page:
        page.text("hello")
        page.send("record")
        while page.frame().state["rows"] < 4:
            page.steer(-0.25, 1.0)
        page.send("end")
        page.text("ended")
    after = "/wheel/after/sessions/mine"
    wait_until(lambda: "Train on it" in user.get(after).text)
    user.press(f"{after}/train")


def test_every_address_of_the_workbench_was_used(user: User, tmp_path: Path) -> None:
    """By the tests above."""
    folders = ProjectFolders(*(tmp_path / name for name in ("sessions", "index", "runs", "drives")))
    bench = Workbench(folders, tmp_path / "cache")
    try:
        routes = [route for route in routes_of(bench) if isinstance(route, Route | WebSocketRoute)]
    finally:
        bench.close()
    unused = [route.path for route in routes if not used(route, user)]
    # a drive's page has the buttons of a session's
    assert {path for path in unused if not path.startswith("/drives/{")} == set()


def used(route: Route | WebSocketRoute, user: User) -> bool:
    for method, address in user.seen:
        path = urlsplit(address).path
        kind = "websocket" if isinstance(route, WebSocketRoute) else "http"
        scope = {"type": kind, "path": path, "method": method, "headers": [], "root_path": ""}
        if route.matches(scope)[0] is Match.FULL:
            return True
    return False
