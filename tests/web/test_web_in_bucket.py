"""`bc-web` over folders in a store shows what it shows of folders here, and asks the store for little."""

from __future__ import annotations

import json
import math
import re
import shutil
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import dataset.cli
import recorder.log_cli
from model.runs.kept_results import keep_result
from recorder import Log
from recorder.log.kept_logs import bring_here
from recorder.log.tags import read_tags
from tests.helpers.bucket import Bucket, serving_bucket
from tests.helpers.drives import a_drive
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import START_NS, write_log
from tests.helpers.runs import a_run
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served
from web.folders import background, stored_folders

TURNING = [0.05 * (row % 9 - 4) for row in range(120)]
SETTINGS = "--labels", "as-recorded", "--block-s", "1", "--gap-s", "0"


@pytest.fixture(scope="module")
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bucket]:
    """A project in a bucket: sessions, one of them tagged, one damaged; an index of two; a drive; runs."""
    folder = tmp_path_factory.mktemp("project")
    with pytest.MonkeyPatch.context() as patched, serving_bucket(folder / "server", patched) as project:
        patched.setenv("BC_CACHE", str(folder / "cache"))
        sessions = project.folder / "sessions"
        for number, name in enumerate(("first", "second", "third")):
            start_ns = START_NS + (number << 45)
            write_log(sessions / f"{name}.mcap", TURNING, lambda _, row: road_jpeg(row), start_ns=start_ns)
        (sessions / "broken.mcap").write_bytes(b"no log")
        (sessions / "notes.txt").write_text("no log")
        a_drive(project.folder / "drives" / "one.mcap", "good")
        run = a_run(project.folder / "runs", "good", 2.0, seed=0)
        keep_result(run, "simulator", {"track": "lake", "set_speed_mph": 10.0, "interventions": 2})
        a_run(project.folder / "runs", "other", 3.0, seed=1)
        tag = "tag", sessions / "second.mcap", "exclude", "--rows", 3, 12
        assert call(recorder.log_cli.main, *tag) == 0
        folders = "--sessions", project.url("sessions"), "--index", project.url("index")
        assert call(dataset.cli.main, "first", "second", *folders, *SETTINGS) == 0
        yield project


@pytest.fixture
def serve(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Served]]:
    """Begin a workbench over the bucket, on a machine that has seen nothing of it; the one before ends. A store is
    asked for a listing once, unless a test says otherwise."""
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(stored_folders, "EVERY_S", math.inf)
    bucket.pass_all()
    running = []

    def begin() -> Served:
        end()
        manager = served(tmp_path, at=bucket.url())
        server = manager.__enter__()
        running.append(manager)
        return server

    def end() -> None:
        while running:
            running.pop().__exit__(None, None, None)

    try:
        yield begin
    finally:
        bucket.pass_all()
        end()


def read(bench: Served, path: str) -> str:
    """A list, when all that it shows is read."""
    bench.get("/changes")

    def whole() -> str:
        text = bench.get(path).text
        return "" if any(words in text for words in ("reading", "being read", "has not answered yet")) else text

    return wait_until(whole)


def asked_for(bucket: Bucket, *folders: str) -> list[str]:
    """What the store was asked for in these folders since it was last looked at, in the order of names: objects by
    their keys, listings by their prefixes. The index and runs may still be on their way when a page is there."""
    asked = [path for _, path, _ in bucket.requests]
    bucket.requests.clear()
    keys = [re.sub(r"^/logs/([^?]*).*|^/logs\?.*prefix=(\w+)%2F.*", r"\1\2", path) for path in asked]
    return sorted(key for key in keys if key.startswith(folders or ("sessions", "drives")))


def test_what_is_shown_is_what_is_shown_of_a_disk(
    bucket: Bucket, serve: Callable[[], Served], tmp_path: Path
) -> None:
    disk = tmp_path / "disk"
    for name in ("sessions", "drives", "runs"):
        shutil.copytree(bucket.folder / name, disk / name)
    folders = "--sessions", disk / "sessions", "--index", disk / "index"
    assert call(dataset.cli.main, "first", "second", *folders, *SETTINGS) == 0
    remote = serve()

    def plain(text: str) -> str:
        text = text.replace("s3://logs/", f"{disk}/")
        return re.sub(r'\?v=\w+|data-version="[^"]*"|name="version_of_index" value="[^"]*"', "", text)

    with served(disk) as local:
        for path in ("/sessions", "/sessions?only=with+tags", "/drives", "/index"):
            # what the index has of each session may come later
            wait_until(lambda path=path: plain(read(remote, path)) == plain(read(local, path)))  # type: ignore[misc]
        at = "/sessions/second"
        for path in ("rows", "tags", "strip.jpg", "steering.svg", "pictures/left/7", "links", "names"):
            shown_remotely, expected = remote.get(f"{at}/{path}"), local.get(f"{at}/{path}")
            assert shown_remotely.status == expected.status == 200
            if path == "tags":
                assert shown_remotely.json | {"version": ""} == expected.json | {"version": ""}
            else:
                assert shown_remotely.body == expected.body
        own = {"version": "", "lag": ""}
        assert remote.get(f"{at}/state").json | own == local.get(f"{at}/state").json | own
        assert remote.get("/index/second/split").body == local.get("/index/second/split").body
        assert remote.get("/index.leaks").body == local.get("/index.leaks").body
        altered = "/index.altered/0/1.jpg"
        assert remote.get(altered).body == local.get(altered).body
        runs = "/runs?run=good&run=other", "/runs/good"
        for path in runs:
            assert plain(read(remote, path)) == plain(read(local, path))
        assert remote.get("/runs.curves?run=good").json == local.get("/runs.curves?run=good").json
        shown = "/drives?log=one"
        assert plain(remote.get(shown).text) == plain(local.get(shown).text)


def test_the_store_is_asked_once_for_what_was_not_seen_yet(bucket: Bucket, serve: Callable[[], Served]) -> None:
    bench = serve()
    read(bench, "/sessions")
    asked = Counter(asked_for(bucket))
    logs = [f"sessions/{name}.mcap" for name in ("broken", "first", "second", "third")]
    assert sorted(asked) == ["drives", "sessions", *logs[:3], "sessions/second.tags.jsonl", logs[3]]
    assert asked["sessions"] == asked["sessions/second.tags.jsonl"] == 1
    assert max(asked[log] for log in logs) <= 3
    for _ in range(20):  # windows
        for path in (
            "/changes",
            "/sessions",
            "/sessions/first",
            "/sessions/first/version",
            "/sessions/first/names",
        ):
            assert bench.get(path).status == 200
    assert asked_for(bucket) == []
    for path in ("strip.jpg", "steering.svg"):
        bench.get(f"/sessions/first/{path}")
    for row in range(len(TURNING)):
        assert bench.get(f"/sessions/first/pictures/center/{row}").body == road_jpeg(row)
    assert set(asked_for(bucket)) == {"sessions/first.mcap"}
    for row in range(len(TURNING)):
        assert bench.get(f"/sessions/first/pictures/center/{row}").body == road_jpeg(row)
    assert asked_for(bucket) == []
    bench = serve()
    read(bench, "/sessions")
    bench.get("/sessions/first/strip.jpg")
    assert asked_for(bucket) == ["drives", "sessions", "sessions/broken.mcap"]  # perhaps it can be read by now
    bench.get("/sessions/first/state")
    opening = asked_for(bucket)
    assert set(opening) == {"sessions/first.mcap"}
    with Log(bucket.url("sessions/first.mcap")) as log:
        bring_here([log])
    bench = serve()
    bench.get("/sessions/first/state")
    assert asked_for(bucket)
    for row in range(len(TURNING)):  # a training has brought the log
        assert bench.get(f"/sessions/first/pictures/center/{row}").body == road_jpeg(row)
    assert asked_for(bucket) == []


def test_of_runs_that_is_brought_which_is_shown(bucket: Bucket, serve: Callable[[], Served]) -> None:
    bench = serve()
    wait_until(lambda: "2 of 2 runs" in read(bench, "/runs"))
    other = "runs/other"
    assert asked_for(bucket, "runs/other") == [f"{other}/config.json", f"{other}/metrics.jsonl"]
    page = bench.get("/runs/other").text
    assert f"s3://logs/{other}" in page
    assert asked_for(bucket, "runs") == [f"{other}/steps.jsonl"]
    read(bench, "/sessions")
    log = bench.get("/sessions/first/state").json["fingerprint"]
    assert asked_for(bucket, "runs") == []
    assert bench.get(f"/sessions/first/predictions/other?log={log}").status == 200
    assert set(asked_for(bucket, "runs")) == {f"{other}/model.safetensors"}
    bench = serve()
    wait_until(lambda: "2 of 2 runs" in read(bench, "/runs"))
    assert bench.get("/runs/other").text == page
    assert asked_for(bucket, "runs") == ["runs"]


def test_what_changes_there_is_seen(
    bucket: Bucket, serve: Callable[[], Served], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stored_folders, "EVERY_S", 0.0)
    bench = serve()
    read(bench, "/sessions")
    before = bench.get("/sessions/first/version").json
    log = bucket.folder / "sessions" / "fourth.mcap"
    write_log(log, TURNING[:77], lambda _, row: road_jpeg(row))
    wait_until(lambda: "77 rows" in read(bench, "/sessions"))
    asked = f"/sessions/fourth/pictures/center/3?v={bench.get('/sessions/fourth/state').json['version']}"
    assert bench.get(asked).status == 200
    write_log(log, TURNING[:88], lambda _, row: road_jpeg(row + 1), overwrite=True)
    wait_until(lambda: "88 rows" in read(bench, "/sessions"))
    assert bench.get(asked).status == 409
    tag = "tag", log, "slow", "--rows", 3, 12
    assert call(recorder.log_cli.main, *tag) == 0
    wait_until(lambda: "slow 10" in read(bench, "/sessions"))
    assert call(recorder.log_cli.main, *tag, "--remove") == 0
    log.unlink()
    log.with_name("fourth.tags.jsonl").unlink()
    wait_until(lambda: "fourth" not in read(bench, "/sessions"))
    assert bench.get("/sessions/fourth").status == 404
    assert bench.get("/sessions/first/version").json == before


def test_a_store_that_does_not_answer_is_a_line_on_the_page(
    bucket: Bucket, serve: Callable[[], Served], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stored_folders, "EVERY_S", 0.0)
    monkeypatch.setattr(background, "AGAIN_S", 0.5)
    hold = threading.Event()
    bucket.answer = lambda passing: not hold.wait() or passing.fail(403, "AccessDenied")
    try:
        bench = serve()
        for path in ("/sessions", "/drives"):  # while nothing comes
            page = bench.get(path)
            assert (page.status, "the store has not answered yet" in page.text) == (200, True)
        assert bench.get("/index").status == bench.get("/runs").status == bench.get("/jobs").status == 200
        missing = bench.get("/sessions/first")
        assert (missing.status, "has not answered yet" in missing.json["error"]) == (503, True)
    finally:
        hold.set()
    for path in ("/sessions", "/drives", "/index"):
        wait_until(lambda path=path: "the store refuses this request" in bench.get(path).text)  # type: ignore[misc]
    bucket.answer = lambda passing: "second.mcap" in passing.path and passing.fail(403, "AccessDenied")
    wait_until(lambda: bench.get("/sessions").text.count("120 rows") == 2)
    wait_until(lambda: "second.mcap: the store refuses" in bench.get("/sessions").text)
    assert bench.get("/sessions").text.count("damaged") == 3  # twice of the log, and in the filter
    bucket.pass_all()
    wait_until(lambda: read(bench, "/sessions").count("120 rows") == 3)
    wait_until(lambda: "refuses" not in bench.get("/sessions").text)
    assert bench.get("/sessions/first/pictures/center/3").status == 200
    bucket.answer = lambda passing: passing.fail(403, "AccessDenied")
    wait_until(lambda: "refuses" in bench.get("/sessions").text)
    assert "120 rows" in bench.get("/sessions").text  # what is known of it stays
    assert bench.get("/sessions/first/pictures/center/3").status == 200
    asked_for(bucket)
    for path in ("first/pictures/center/100", "third/state"):
        refused = bench.get(f"/sessions/{path}")
        assert (refused.status, "refuses" in refused.json["error"]) == (503, True)
    assert "sessions/third.mcap" not in asked_for(bucket)  # it would not answer: nobody waits for that


def test_logs_are_tagged_and_made_there(bucket: Bucket, serve: Callable[[], Served]) -> None:
    bench = serve()
    read(bench, "/sessions")
    at = "/sessions/third"
    assert bench.get(f"{at}/tags").json["tags"] == []
    log = bench.get(f"{at}/state").json["fingerprint"]
    tags = bucket.folder / "sessions" / "third.tags.jsonl"

    def change(action: str) -> dict[str, Any]:
        asked = json.dumps({"action": action, "name": "slow", "rows": [[3, 12]], "log": log}).encode()
        answer = bench.ask("POST", f"{at}/tags", asked, Content_Type="application/json")
        assert answer.status == 200, answer.text
        return dict(answer.json)

    command = "bc-log tag s3://logs/sessions/third.mcap slow --rows 3 12"
    asked_for(bucket)
    assert change("add")["commands"] == [command]
    assert "sessions" not in asked_for(bucket)  # no listing
    shown = bench.get(f"{at}/tags").json
    assert [shown["names"][number] for _, _, number in shown["tags"]] == ["slow"]
    assert bench.get(f"{at}/version").json["tags"] == shown["version"]
    assert [tag.name for tag in read_tags(tags.with_name("third.mcap"), log)] == ["slow"]
    assert "slow 10" in read(bench, "/sessions")
    assert change("add") == {"changed": [], "commands": [], "notice": ""}
    assert change("remove")["commands"] == [f"{command} --remove"]
    assert bench.get(f"{at}/tags").json["tags"] == []
    tags.unlink()
    refused = bench.get(f"{at}/make/trim/command?first=0&last=1").text
    assert refused.endswith("copy it first: `bc-log copy s3://logs/sessions/third.mcap FOLDER`")
    assert bench.get(f"{at}/make/check/command").text == "bc-log check s3://logs/sessions/third.mcap"
    assert "/make/check" in read(bench, at)
    assert "/make/trim" not in read(bench, at)
    record = bench.get("/jobs.command?form=record&name=new").text
    assert record == "bc-record new --copy-to=s3://logs/sessions"
    evaluate = bench.get("/jobs.command?form=evaluate&run=good&session=first").text
    assert evaluate == "bc-eval good --session first --runs=s3://logs/runs --sessions=s3://logs/sessions"
    evaluate = bench.get("/jobs.command?form=evaluate&run=good").text
    assert evaluate == "bc-eval good --runs=s3://logs/runs --sessions=s3://logs/sessions"
