"""What the page of a session is given, and what is written when it tags rows: the same as `bc-log tag` writes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import recorder.log_cli
from common.car import Camera
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Answer, Served, served

STEERING = [0.01 * (row % 40) for row in range(120)]


def road(camera: Camera, row: int) -> bytes:
    return b"no picture" if row == 7 else road_jpeg(row)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("bench")
    write_log(folder / "sessions" / "a.mcap", STEERING, road, cameras=["center"])
    write_log(folder / "drives" / "a.mcap", [0.5])
    with served(folder) as server:
        yield server


@pytest.fixture
def log(bench: Served) -> Iterator[Path]:
    """The session without tags."""
    path = bench.folder / "sessions" / "a.mcap"
    yield path
    path.with_name("a.tags.jsonl").unlink(missing_ok=True)


def change(bench: Served, at: str = "/sessions/a", **changed: Any) -> Answer:
    """Ask for rows 3 to 9 to be excluded, or for something else."""
    fingerprint = bench.get(f"{at}/state").json.get("fingerprint")
    asked = {"action": "add", "name": "exclude", "rows": [[3, 9]], "log": fingerprint, **changed}
    return bench.ask("POST", f"{at}/tags", json.dumps(asked).encode(), Content_Type="application/json")


def lines(log: Path) -> list[Any]:
    path = log.with_name(log.name.replace(".mcap", ".tags.jsonl"))
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def test_tags_are_written_as_the_command_writes_them(bench: Served, log: Path) -> None:
    before = log.read_bytes()
    answer = change(bench)
    assert answer.json == {"changed": [[3, 9]], "commands": [f"bc-log tag {log} exclude --rows 3 9"], "notice": ""}
    assert change(bench).json["changed"] == []
    by_page = lines(log)
    assert change(bench, action="remove").json["commands"] == [f"bc-log tag {log} exclude --rows 3 9 --remove"]
    assert change(bench, action="remove").json["changed"] == []
    by_page = lines(log)
    log.with_name("a.tags.jsonl").unlink()
    for flags in ([], ["--remove"]):
        assert call(recorder.log_cli.main, "tag", log, "exclude", "--rows", 3, 9, *flags) == 0
    assert lines(log) == by_page
    assert log.read_bytes() == before


@pytest.mark.parametrize(
    ("changed", "status", "why"),
    [
        ({"rows": [[3, 9], [9, 3]]}, 422, "the first row, then the last"),
        ({"rows": [[3, 9], [0, 120]]}, 422, "its rows are 0 to 119"),
        ({"rows": [[-1, 3]]}, 422, "the first row"),
        ({"rows": [[1.5, 3]]}, 422, "int"),
        ({"rows": [[1]]}, 422, "length"),
        ({"rows": []}, 422, "length"),
        ({"name": ""}, 422, "not a name"),
        ({"name": "a\nb"}, 422, "not a name"),
        ({"name": "x" * 65}, 422, "not a name"),
        ({"name": "--rows"}, 422, "a flag"),
        ({"action": "delete"}, 422, "action"),
        ({"path": "/etc/passwd"}, 422, "path"),
        ({"log": "0" * 64}, 409, "replaced"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(
    bench: Served, log: Path, changed: dict[str, Any], status: int, why: str
) -> None:
    answer = change(bench, **changed)
    assert (answer.status, why in answer.json["error"]) == (status, True), answer.text
    assert lines(log) == []


def test_only_json_changes_anything(bench: Served, log: Path) -> None:
    """A form of another page can send text, but not this type."""
    body = json.dumps({"action": "add", "name": "exclude", "rows": [[3, 9]], "log": "x"}).encode()
    assert bench.ask("POST", "/sessions/a/tags", body, Content_Type="text/plain").status == 415
    assert bench.ask("POST", "/sessions/a/tags", b"{", Content_Type="application/json").status == 422
    assert bench.ask("PUT", "/sessions/a/tags", b"{}", Content_Type="application/json").status == 405
    assert lines(log) == []


def test_a_new_name_that_is_nearly_an_old_one_is_noticed(bench: Served, log: Path) -> None:
    assert change(bench, name="exlude").json["notice"] == "new tag 'exlude'. did you mean exclude?"
    assert change(bench, name="exlude", rows=[[50, 60]]).json["notice"] == ""
    assert bench.get("/sessions/a/names").json == ["exclude", "exlude", "fine"]


def test_the_rows_are_those_of_the_log(bench: Served) -> None:
    row, time_s, steering, throttle, _, mph = np.frombuffer(bench.get("/sessions/a/rows").body).reshape(6, -1)
    assert row.tolist() == list(range(120))
    assert time_s == pytest.approx(np.arange(120) / 10)
    assert steering.tolist() == STEERING
    assert set(throttle) == {0.5}
    assert set(mph) == {9.0}
    assert len(bench.get("/drives/a/rows").body) == 6 * 8


def test_pictures_are_given_byte_for_byte(bench: Served) -> None:
    answer = bench.get("/sessions/a/pictures/center/50")
    assert (answer.headers["content-type"], answer.body) == ("image/jpeg", road_jpeg(50))
    assert answer.headers["cache-control"] == "no-store"
    version = bench.get("/sessions/a/state").json["version"]
    assert "immutable" in bench.get(f"/sessions/a/pictures/center/50?v={version}").headers["cache-control"]
    refused = {
        "center/120": 404,
        "left/5": 404,
        "rear/5": 404,
        "center/7": 415,
        "center/x": 404,
        "center/5?v=0": 409,
    }
    for path, status in refused.items():
        answer = bench.get(f"/sessions/a/pictures/{path}")
        assert (answer.status, bool(answer.json["error"])) == (status, True), path


def test_odd_rows_and_pictures_are_reported(tmp_path: Path) -> None:
    """Frozen pictures, where the index or the page has looked at them."""
    import dataset.cli

    log = write_log(
        tmp_path / "sessions" / "a.mcap",
        [0.4 if 10 <= row < 50 else 0.01 * row for row in range(80)],
        lambda camera, row: road_jpeg(min(row, 60)),
        cameras=["center"],
    )
    with served(tmp_path) as bench:
        stuck, frozen = ["stuck_steering", 10, 49, "at 0.4", False], ["frozen_picture", 60, 79, "", False]
        assert bench.get("/sessions/a/state").json["odd"] == [stuck]
        assert bench.ask("POST", "/sessions/a/look", b"").status == 200
        wait_until(lambda: bench.get("/sessions/a/look").json["about"])
        looked = bench.get("/sessions/a/state").json
        assert looked["odd"] == [stuck, frozen]
        shutil.rmtree(tmp_path / "cache")
        assert bench.get("/sessions/a/state").json["pictures_checked"] is False
        flags = ("--sessions", log.parent, "--index", tmp_path / "index", "--look", "--block-s", 1, "--gap-s", 0)
        assert call(dataset.cli.main, *flags) == 0
        assert frozen in bench.get("/sessions/a/state").json["odd"]


def test_rows_for_which_a_condition_holds_are_found(bench: Served) -> None:
    answer = bench.get("/sessions/a/where?condition=row%20%3C%202%20or%20row%20%3D%204")
    assert answer.json == [[0, 1], [4, 4]]
    refused = bench.get("/sessions/a/where?condition=import%20os")
    assert (refused.status, "columns are row, time_s" in refused.json["error"]) == (422, True)


def test_a_log_that_is_not_finished_is_shown_but_not_tagged(bench: Served) -> None:
    """Its tags would be lost when it is recovered."""
    whole = (bench.folder / "sessions" / "a.mcap").read_bytes()
    part = bench.folder / "sessions" / "k.mcap.0a1b2c.part"
    part.write_bytes(whole[: len(whole) * 2 // 3])
    at = "/sessions/k.mcap.0a1b2c.part"
    assert "bc-log recover" in bench.get(f"{at}/state").json["problem"]
    assert bench.get(at).status == 200
    answer = change(bench, at, rows=[[0, 1]])
    assert (answer.status, "bc-log recover" in answer.json["error"]) == (409, True)
    assert not list(part.parent.glob("k*.tags.jsonl"))
