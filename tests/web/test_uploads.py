"""Uploads of recordings: whole or not at all, nothing outside their folder, and imported by the usual job."""

from __future__ import annotations

import html
import re
import socket
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import recorder.import_cli
import web.folders.uploads
from recorder import Log
from tests.helpers.logs import write_log
from tests.helpers.udacity import call, make_recording, paths
from tests.helpers.upload_bodies import upload, upload_body, zipped
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served

CSV = "".join(f"{paths(number)},0.1,0.5,0,9.5\n" for number in range(4))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as server:
        yield server


def lake(folder: Path) -> dict[str, bytes]:
    """The files of a small recording, by their paths in an upload."""
    make_recording(folder / "lake", CSV, numbers=range(3))
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def left_by(bench: Served) -> list[Path]:
    return list((bench.folder / "recordings").rglob("*")) if (bench.folder / "recordings").exists() else []


def values_of(page: str) -> dict[str, str]:
    """The values of the first form of a page."""
    fields = re.findall(r'<input[^>]*name="(\w+)" value="([^"]*)"', page)
    return {name: html.unescape(value) for name, value in fields}


@pytest.mark.parametrize("as_zip", [False, True])
def test_an_upload_is_imported_as_by_the_command(bench: Served, tmp_path: Path, as_zip: bool) -> None:
    files = lake(tmp_path / "mine")
    answer = upload(bench, {"lake.zip": zipped(files)} if as_zip else files)
    page = answer.json["page"]
    shown = bench.get(page).text
    assert "4 rows" in shown
    assert "pictures that a row names and no file has" in shown  # of the fourth row
    assert page == "/import/lake"
    job = bench.post("/jobs", **values_of(shown)).headers["location"]
    wait_until(lambda: "running" not in bench.get(job).text)
    command = tmp_path / "mine" / "sessions"
    assert call(recorder.import_cli.main, tmp_path / "mine" / "lake", "lake", "--sessions", command) == 3
    with Log(bench.folder / "sessions" / "lake.mcap") as by_page, Log(command / "lake.mcap") as by_command:
        assert by_page.vehicle() == by_command.vehicle()
    assert bench.ask("POST", f"{page}/remove").status == 303
    assert left_by(bench) == []
    assert bench.get(page).status == 404


def test_what_the_page_asks_is_answered_in_its_form(bench: Served, tmp_path: Path) -> None:
    steering = [0.53] * 10 + [0.15, 0.85]
    csv = "".join(f"{paths(number)},{value},0.5,0,9.5\n" for number, value in enumerate(steering))
    make_recording(tmp_path / "servo", csv, numbers=range(len(steering)))
    shown = bench.get(f"/import.at?source={tmp_path / 'servo'}").text
    assert "<code>--steering-offset -0.53</code>, if 0.53 is straight on?" in shown
    job = bench.post("/jobs", **(values_of(shown) | {"steering_offset": "-0.53"})).headers["location"]
    wait_until(lambda: "running" not in bench.get(job).text)
    with Log(bench.folder / "sessions" / "servo.mcap") as log:
        assert [round(value, 6) for value in log.vehicle()["steering"].to_pylist()] == [0.0] * 10 + [-0.38, 0.32]


def test_a_recording_on_the_machine_is_found_by_its_folders(
    bench: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "home"
    lake(home / "my drives")
    (home / ".hidden").mkdir()
    (home / "<b>\n").mkdir()
    (home / "notes.txt").write_text("no recording")
    write_log(home / "own.mcap", [0.1])
    monkeypatch.setenv("HOME", str(home))
    first = bench.get("/import.at").text
    assert "copy it to your recordings" in first
    addresses = re.findall(r'href="(/import.at[^"]*)"', first)
    assert len(addresses) == 2  # the folder above, and the one that can be shown
    second = bench.get(addresses[1]).text
    (lake_page,) = re.findall(r'href="(/import.at[^"]*lake)"', second)
    shown = bench.get(lake_page).text
    assert "4 rows" in shown
    assert values_of(shown)["source"] == str(home / "my drives" / "lake")
    assert values_of(shown)["name"] == "lake"
    assert "<h2 id=" not in bench.get(f"/import.at?source={home}/notes.txt").text
    for missing in ("/nowhere", "~nobody", "%00", "x" * 5000):
        assert bench.get(f"/import.at?source={missing}").status == 404, missing
    assert bench.get("/import.at", Sec_Fetch_Site="cross-site").status == 403


def test_a_session_of_this_toolkit_is_taken_as_it_is(bench: Served, tmp_path: Path) -> None:
    data = write_log(tmp_path / "own.mcap", [0.1, 0.2]).read_bytes()
    page = upload(bench, {"own.mcap": data}).json["page"]
    values = values_of(bench.get(page).text)
    assert bench.post(f"{page}/take", **values).headers["location"] == "/sessions/own"
    assert (bench.folder / "sessions" / "own.mcap").read_bytes() == data
    assert left_by(bench) == []
    upload(bench, {"own.mcap": data})
    assert "own-2" in bench.get(page).text  # no session is replaced
    answer = bench.post(f"{page}/take", **values)
    assert (answer.status, "own.mcap: exists already" in answer.text) == (409, True)


def test_a_session_does_not_get_tags_that_another_one_left(bench: Served, tmp_path: Path) -> None:
    """Its own tags could not be moved after it."""
    page = upload(bench, {"own.mcap": write_log(tmp_path / "own.mcap", [0.1, 0.2]).read_bytes()}).json["page"]
    (bench.folder / "sessions").mkdir(exist_ok=True)
    (bench.folder / "sessions" / "own.tags.jsonl").write_text("")
    answer = bench.post(f"{page}/take", **values_of(bench.get(page).text))
    assert (answer.status, "own.tags.jsonl: exists already" in answer.text) == (409, True)
    assert "own.mcap" in bench.get(page).text


def test_a_broken_off_upload_leaves_nothing(bench: Served, tmp_path: Path) -> None:
    body, manifest = upload_body(lake(tmp_path / "mine"))
    with socket.create_connection(("127.0.0.1", bench.port)) as connection:
        head = f"POST /import.upload?manifest={manifest} HTTP/1.1\r\nHost: 127.0.0.1:{bench.port}\r\n"
        head += f"Authorization: Bearer {bench.token}\r\n"
        connection.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body[: len(body) // 2])
        wait_until(lambda: left_by(bench))
        assert "recording." not in bench.get("/import").text  # no link to what is not whole
    wait_until(lambda: not (bench.folder / "recordings").exists())


@pytest.mark.parametrize(
    "name",
    [
        "../out",
        "lake/../../out",
        "/etc/out",
        "lake//out",
        "lake/.",
        "c:out",
        "lake\\out",
        "lake/\x00",
        "lake/a\nb",
        "lake/\ud800",
        "x" * 300,
        "",
    ],
)
def test_names_that_lead_elsewhere_are_refused(bench: Served, tmp_path: Path, name: str) -> None:
    before = sorted(tmp_path.rglob("out"))
    assert upload(bench, {name: b"x"}).status == 422
    if name.isprintable() and name:
        assert upload(bench, {"a.zip": zipped({name: b"x"})}).status == 422
    assert left_by(bench) == []
    assert sorted(tmp_path.rglob("out")) == before


def test_zips_that_nobody_would_want_are_refused(bench: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = zipped({"a": b"x" * 1000, "b": b"y" * 1000})
    link = zipped({"a": b"/etc/passwd"}, external_attr=0o120777 << 16)
    damaged = whole.replace(b"a", b"b", 1)
    bad: dict[str, bytes] = {"cut off": whole[:-30], "a link": link, "damaged": damaged, "no zip": b"no zip"}
    bad["LZMA"] = zipped({"a": b"x" * 1000}, compress_type=zipfile.ZIP_LZMA)  # damaged ones raise other errors
    bad["directory"] = whole[:-22] + whole[-22:-10] + (1 << 30).to_bytes(4, "little") + whole[-6:]
    for why, data in bad.items():
        assert upload(bench, {"a.zip": data}).status in (413, 422), why
        assert left_by(bench) == [], why
    monkeypatch.setattr(web.folders.uploads, "MAX_UPLOAD_BYTES", 1500)  # packed, it is smaller
    assert upload(bench, {"a.zip": whole}).status == 413
    monkeypatch.undo()
    monkeypatch.setattr(web.folders.uploads, "MAX_FILES", 1)
    assert upload(bench, {"a.zip": whole}).status == 413
    assert upload(bench, {"a": b"", "b": b""}).status == 422
    assert left_by(bench) == []


def test_bodies_that_are_not_what_they_say_are_refused(bench: Served) -> None:
    body, manifest = upload_body({"a": b"xyz", "b": b""})
    for wrong, length in (
        (body + b"x", manifest),
        (body[:-1], manifest),
        (body, manifest - 1),
        (b"[1]", 3),
        (body, 0),
        (body, 10**9),
    ):
        assert bench.ask("POST", f"/import.upload?manifest={length}", wrong).status in (413, 422)
    assert upload(bench, [("a", b"1"), ("a", b"2")]).status == 422
    assert upload(bench, [("a", b"1"), ("a/b", b"2")]).status == 422
    assert upload(bench, [("a/b", b"1"), ("a", b"2")]).status == 422
    assert upload(bench, {"__MACOSX/a": b"1", ".DS_Store": b"2"}).status == 422
    assert left_by(bench) == []
    assert bench.ask("POST", "/import.upload?manifest=1", b"{", Origin="http://evil.example").status == 403


def test_a_full_disk_refuses_before_anything_is_written(bench: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web.folders.uploads, "_SPARE_BYTES", 1 << 60)
    answer = upload(bench, {"a": b"x"})
    assert (answer.status, "has room for 0" in answer.json["error"]) == (507, True)
    assert left_by(bench) == []


def test_two_uploads_of_one_name_do_not_mix(bench: Served) -> None:
    pages = [upload(bench, {"lake/a": b"1"}).json["page"] for _ in range(2)]
    assert pages == ["/import/lake", "/import/lake-2"]
    assert "There is no recording in it" in bench.get(pages[1]).text
    for name in ("none", "..", "%2e%2e", "lake.0a1b2c.part"):
        assert bench.get(f"/import/{name}").status == 404
