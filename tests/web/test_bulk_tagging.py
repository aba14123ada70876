"""Rows of several logs that are found and tagged by one request each, as the list of sessions asks for them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from recorder import Log
from recorder.log.tags import Tag, read_tags
from tests.helpers.faulty_session import CRASH, GAP_AT, STUCK, write_faulty
from tests.helpers.logs import write_log
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Answer, Served, served

CRASHES = "/sessions.found?only=with+crash"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    for name in ("first", "second"):
        write_faulty(tmp_path / "sessions" / f"{name}.mcap")
    write_log(tmp_path / "sessions" / "good.mcap", [0.01 * (row % 40) for row in range(50)])
    with served(tmp_path) as server:
        wait_until(lambda: "being read" not in server.get("/sessions").text)
        yield server


def found_rows(bench: Served, at: str) -> dict[str, list[list[int]]]:
    answer = bench.get(at)
    assert answer.status == 200, answer.text
    return {log["key"]: log["rows"] for log in answer.json["logs"]}


def change(bench: Served, rows: Any, **changed: Any) -> Answer:
    body = json.dumps({"action": "add", "name": "exclude", "rows": rows, **changed}).encode()
    return bench.ask("POST", "/sessions.tags", body, Content_Type="application/json")


def asked(bench: Served, at: str = CRASHES) -> list[dict[str, Any]]:
    return [{name: log[name] for name in ("key", "log", "rows")} for log in bench.get(at).json["logs"]]


def tags(bench: Served, name: str) -> list[Tag]:
    log = bench.folder / "sessions" / f"{name}.mcap"
    with Log(log) as opened:
        return read_tags(log, opened.fingerprint)


def test_what_a_kind_or_a_condition_finds_is_named_by_log(bench: Served) -> None:
    assert found_rows(bench, CRASHES) == {"first": [[*CRASH]], "second": [[*CRASH]]}
    assert found_rows(bench, "/sessions.found?only=with+stuck+steering") == {
        "first": [[*STUCK]],
        "second": [[*STUCK]],
    }
    assert found_rows(bench, "/sessions.found?only=with+gap&text=first") == {"first": [[GAP_AT - 1, GAP_AT]]}
    assert found_rows(bench, "/sessions.found?only=with+surely+odd+rows&text=second") == {"second": [[*CRASH]]}
    where = "/sessions.found?where=row+%3C+2+or+row+%3E+48"
    assert found_rows(bench, f"{where}&text=good") == {"good": [[0, 1], [49, 49]]}


def test_a_log_that_cannot_be_tagged_is_named_and_the_others_are(bench: Served) -> None:
    rows = asked(bench)
    write_log(bench.folder / "new.mcap", [0.1] * 400)
    (bench.folder / "new.mcap").replace(bench.folder / "sessions" / "first.mcap")
    answer = change(bench, [*rows, {"key": "gone", "log": "0" * 64, "rows": [[1, 2]]}]).json
    assert [log["key"] for log in answer["changed"]] == ["second"]
    assert "first: the log has been replaced" in answer["notice"]
    assert "gone: " in answer["notice"]
    assert tags(bench, "second") == [Tag(*CRASH, "exclude")]
    assert tags(bench, "first") == []


def test_what_is_no_query_or_no_change_is_refused(bench: Served) -> None:
    assert bench.get("/sessions.found").status == 422
    assert bench.get("/sessions.found?where=drop+table").status == 422
    rows = asked(bench)
    for body, status in (
        ({"name": "--rows"}, 200),  # by each log, with the reason
        ({"action": "delete"}, 422),
    ):
        assert change(bench, rows, **body).status == status, body
    for wrong in ({**rows[0], "rows": []}, {**rows[0], "path": "/etc/passwd"}, [1, 2]):
        assert change(bench, [wrong]).status == 422, wrong
    asked_as_text = json.dumps({"action": "add", "name": "exclude", "rows": rows}).encode()
    assert bench.ask("POST", "/sessions.tags", asked_as_text, Content_Type="text/plain").status == 415
    assert tags(bench, "first") == tags(bench, "second") == []
