"""`bc-copy FROM TO`: sessions, indexes and runs in a bucket and back, whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from drive.copy_cli import main
from model import find_run
from model.runs.run_files import locked_for_training
from recorder.log.reader import Log
from recorder.log.tags import Tag, add_tags
from tests.helpers.bucket import Bucket
from tests.helpers.driving import one_line_in
from tests.helpers.faulty_proxy import Passing
from tests.helpers.logs import write_log
from tests.helpers.runs import a_run
from tests.helpers.udacity import call

RUN = "s3://logs/runs/night"

Steps = Sequence[Callable[[], object]]


def copy(*arguments: object) -> int:
    return call(main, *arguments)


def files(folder: Path) -> dict[str, bytes]:
    """The files that people see in a folder."""
    paths = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def change(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    written_ns = path.stat().st_mtime_ns + 1_000_000_000
    os.utime(path, ns=(written_ns, written_ns))


@pytest.fixture
def run(bucket: Bucket) -> Path:
    run = a_run(Path("runs"), "night")
    (run / "last").mkdir(exist_ok=True)
    (run / "last/checkpoint.safetensors").write_bytes(bytes(100_000))
    (run / "last/.lock").touch()
    (run / "config.json.aaaaaa.part").touch()
    return run


@pytest.fixture
def seen(run: Path) -> dict[str, bytes]:
    """What is copied of the run."""
    return {name: data for name, data in files(run).items() if not name.endswith(".part")}


def test_a_run_goes_to_the_bucket_and_back(bucket: Bucket, run: Path, seen: dict[str, bytes]) -> None:
    assert copy(run, RUN) == 0
    assert files(bucket.folder / "runs/night") == seen
    assert copy(RUN, "back/night") == 0
    assert files(Path("back/night")) == seen
    weights = "model.safetensors"
    assert (Path("back/night") / weights).stat().st_mtime_ns == (run / weights).stat().st_mtime_ns
    assert find_run("night", Path("back")) == Path("back/night")


def test_what_is_there_already_is_not_copied_again(
    bucket: Bucket, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy(run, RUN)
    copy(RUN, "back")
    bucket.requests.clear()
    capsys.readouterr()
    assert copy(run, RUN) == 0
    assert copy(RUN, "back") == 0
    assert bucket.count("PUT") == 0
    assert all("model.safetensors" not in path for _, path, _ in bucket.requests)
    assert capsys.readouterr().out.splitlines() == [f"{RUN}: was there already", "back: was there already"]


def test_a_project_goes_to_the_bucket_and_back(bucket: Bucket, run: Path, seen: dict[str, bytes]) -> None:
    log = write_log(Path("project/sessions/a.mcap"), [0.1] * 20)
    with Log(log) as opened:
        add_tags(log, opened.fingerprint, [Tag(1, 2, "exclude")])
    shutil.copytree(run, "project/runs/night", ignore=shutil.ignore_patterns(".*", "*.part"))
    shutil.copytree(run, "project/runs/day", ignore=shutil.ignore_patterns(".*", "*.part"))
    index = Path("project/index")
    (index / "frames").mkdir(parents=True)
    (index / "samples.parquet").write_bytes(b"samples")
    (index / "frames/a.parquet").write_bytes(b"frames")
    before = files(Path("project"))
    assert copy("project", "s3://logs/lab") == 0
    assert files(bucket.folder / "lab") == before
    assert copy("s3://logs/lab", "back") == 0
    assert files(Path("back")) == before
    assert files(Path("back/runs/day")) == seen

    shutil.rmtree("back/runs/day")
    assert copy("s3://logs/lab/runs", "back/runs") == 0
    assert files(Path("back")) == before
    assert copy("s3://logs/lab/sessions/a.mcap", "one.mcap") == 0
    assert Path("one.mcap").read_bytes() == log.read_bytes()


def test_nothing_is_overwritten_unasked(
    bucket: Bucket, run: Path, seen: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    copy(run, RUN)
    change(run / "metrics.jsonl", b"{}\n")
    (run / "results.jsonl").write_bytes(b"{}\n")
    capsys.readouterr()
    assert copy(run, RUN) == 1
    assert f"{RUN} exists already, with another metrics.jsonl" in one_line_in(capsys)
    assert files(bucket.folder / "runs/night") == seen
    assert copy(run, RUN, "--force") == 0
    assert (bucket.folder / "runs/night/metrics.jsonl").read_bytes() == b"{}\n"

    for flags in ((), ("--force",)):
        Path("back").mkdir(exist_ok=True)
        Path("back/mine").write_text("mine")
        assert copy(RUN, "back", *flags) == 1
        assert files(Path("back")) == {"mine": b"mine"}


def test_a_run_does_not_mix_with_others(bucket: Bucket, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy(run, RUN)
    capsys.readouterr()
    assert copy(run, "s3://logs/runs", "--force") == 1
    assert f"s3://logs/runs holds other files: give a new place, such as {RUN}" in one_line_in(capsys)
    assert not (bucket.folder / "runs/config.json").exists()
    assert copy(RUN, "runs") == 1
    assert "runs exists already, with other files: give a new place, such as runs/night" in one_line_in(capsys)


def test_an_upload_that_was_cut_off_is_not_taken_for_a_run(
    bucket: Bucket, run: Path, seen: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    bucket.answer = lambda passing: (
        passing.command == "PUT" and "config.json" in passing.path and passing.fail(403, "AccessDenied")
    )
    assert copy(run, RUN) == 1
    bucket.pass_all()
    assert files(bucket.folder / "runs/night") not in ({}, seen)
    capsys.readouterr()
    assert copy("s3://logs/runs", "back") == 1
    assert "no log, index or run in it" in one_line_in(capsys)
    shutil.copy(run / "config.json", bucket.folder / "runs/night")
    assert copy(RUN, "back") == 1
    assert "its upload is not finished" in one_line_in(capsys)
    assert not Path("back").exists()
    assert copy(RUN, "part", "--unfinished") == 0
    assert files(Path("part")) == files(bucket.folder / "runs/night")

    assert copy(run, RUN) == 0
    assert copy(RUN, "back") == 0
    assert files(Path("back")) == seen


def test_a_download_that_fails_leaves_nothing(bucket: Bucket, run: Path) -> None:
    copy(run, RUN)
    bucket.answer = lambda passing: "checkpoint" in passing.path and passing.fail(403, "AccessDenied")
    assert copy(RUN, "back/night") == 1
    assert not Path("back").exists()


def test_damage_in_the_bucket_is_found(bucket: Bucket, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy(run, RUN)
    record = bucket.folder / "runs/night/.store.json"
    stored = json.loads(record.read_text())
    stored["files"]["metrics.jsonl"]["sha256"] = "0" * 64
    record.write_text(json.dumps(stored))
    capsys.readouterr()
    assert copy(RUN, "back") == 1
    assert "metrics.jsonl: damaged" in one_line_in(capsys)


def test_a_run_of_another_program_or_an_earlier_version_is_brought(
    bucket: Bucket, run: Path, seen: dict[str, bytes]
) -> None:
    copy(run, RUN)
    record = bucket.folder / "runs/night/.store.json"
    stored = json.loads(record.read_text())
    for entry in stored["files"].values():  # as version 0.3 wrote them
        entry |= {"e_tag": f'"{entry["e_tag"]}"', "version": None}
        del entry["sha256"]
    record.write_text(json.dumps(stored | {"left": {}, "told_by": ""}))
    assert copy(RUN, "earlier") == 0
    record.unlink()
    assert copy(RUN, "other") == 0
    assert files(Path("earlier")) == files(Path("other")) == seen
    assert copy(run, RUN) == 0


@pytest.fixture
def after_each_copy(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> Callable[[Steps], None]:
    """Do one of these steps after each copy of a run, before the next one."""
    monkeypatch.setattr("drive.copy_cli._EVERY_S", 0)

    def do(steps: Steps) -> None:
        left = iter([lambda: None, *steps])  # the first record says that a copy begins

        def answer(passing: Passing) -> bool:
            if passing.command == "PUT" and ".store.json" in passing.path:
                next(left, lambda: None)()
            return False

        bucket.answer = answer

    return do


def test_a_growing_run_is_followed_until_its_training_ends(
    bucket: Bucket, run: Path, after_each_copy: Callable[[Steps], None]
) -> None:
    with contextlib.ExitStack() as training:
        training.enter_context(locked_for_training(run))

        def end() -> None:
            change(run / "metrics.jsonl", b"1\n2\n")
            training.close()

        after_each_copy(
            [
                lambda: change(run / "metrics.jsonl", b"1\n"),
                lambda: change(run / "last/checkpoint.safetensors", b"2\n"),
                end,
            ]
        )
        assert copy(run, RUN, "--follow") == 0
    assert files(bucket.folder / "runs/night") == {
        name: data for name, data in files(run).items() if not name.endswith(".part")
    }
    assert (bucket.folder / "runs/night/metrics.jsonl").read_bytes() == b"1\n2\n"
    assert copy(RUN, "back") == 0


def test_a_run_is_followed_though_the_store_fails_for_a_while(
    bucket: Bucket, run: Path, after_each_copy: Callable[[Steps], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with contextlib.ExitStack() as training:
        training.enter_context(locked_for_training(run))

        def refuse(passing: Passing) -> bool:
            training.close()
            return passing.fail(403, "AccessDenied")

        def fail() -> None:
            change(run / "metrics.jsonl", b"1\n")
            bucket.fail_first("GET", refuse)

        after_each_copy([fail])
        assert copy(run, RUN, "--follow") == 0
    assert "AccessDenied" in capsys.readouterr().err
    assert (bucket.folder / "runs/night/metrics.jsonl").read_bytes() == b"1\n"


def test_another_machine_that_follows_the_same_run_gets_an_error(
    bucket: Bucket, run: Path, after_each_copy: Callable[[Steps], None], capsys: pytest.CaptureFixture[str]
) -> None:
    stored = bucket.folder / "runs/night/metrics.jsonl"
    with contextlib.ExitStack() as training:
        training.enter_context(locked_for_training(run))

        def interfere() -> None:
            change(run / "metrics.jsonl", b"mine\n")
            stored.write_bytes(b"its\n")
            training.close()

        after_each_copy([interfere])
        assert copy(run, RUN, "--follow") == 1
    assert "exists already, with another metrics.jsonl" in capsys.readouterr().err
    assert stored.read_bytes() == b"its\n"


def test_every_request_fails_the_first_time(bucket: Bucket, run: Path, seen: dict[str, bytes]) -> None:
    bucket.fail_each_once()
    assert copy(run, RUN) == 0
    assert copy(RUN, "back") == 0
    assert files(Path("back")) == seen


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [
        (("runs/night", "elsewhere"), 2, "one place is on this machine, the other in a bucket"),
        (("s3://logs/a", "s3://logs/b"), 2, "one place is on this machine, the other in a bucket"),
        (("s3://logs/a", "here", "--follow"), 2, "only a run of this machine can be followed"),
        (("s3://logs/nothing", "here"), 1, "no log, index or run in it"),
        (("nothing", "s3://logs/nothing"), 1, "nothing: no such log, index or run"),
        (("runs/night/last", "s3://logs/nothing"), 1, "no log, index or run in it"),
        (("s3://other/runs", "here"), 1, "no such bucket"),
        (("s3:/logs/runs", "here"), 2, "the URL is spelt s3://logs/runs"),
    ],
)
def test_an_error_is_one_line(
    run: Path, arguments: tuple[str, ...], code: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert copy(*arguments) == code
    assert line in one_line_in(capsys)
