"""An index names its logs; those of somebody else's index are opened in its project, or where the user says."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from bucket import Bucket
from dataset import DatasetError, Samples
from driving import one_line_of, run, run_code
from toy import toy_index
from workbench import served

pytestmark = pytest.mark.usefixtures("project")

KEY = b"bc.index"


class Opened:
    """The files beneath a folder that anything in this process opens."""

    def __init__(self) -> None:
        self.files: list[str] = []
        self._folder = ""
        sys.addaudithook(self._hear)  # there for good: it has to be quiet again

    def watch(self, folder: Path | None) -> None:
        self.files, self._folder = [], str(folder or "")

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self._folder and event == "open" and Path(str(arguments[0])).resolve().is_relative_to(self._folder):
            self.files.append(str(arguments[0]))


OPENED = Opened()


@pytest.fixture
def opened() -> Iterator[Opened]:
    yield OPENED
    OPENED.watch(None)


def name_log(index: Path, name: str) -> None:
    path = index / "samples.parquet"
    table = pq.read_table(path)
    stored = json.loads(table.schema.metadata[KEY])
    stored["logs"]["toy"]["log"] = name
    pq.write_table(table.replace_schema_metadata({KEY: json.dumps(stored).encode()}), path)


def copied(project: Path, name: str) -> Path:
    """A copy of an index that was built elsewhere, in which its log, private/toy.mcap, is named so."""
    shutil.copytree(toy_index(project.parent / "private"), project / "index")
    name_log(project / "index", name)
    return project / "index"


@pytest.mark.parametrize(
    "name_of",
    [
        lambda log: "../../private/toy.mcap",
        lambda log: "../sessions/../../private/toy.mcap",
        str,
        lambda log: log.as_uri(),
        lambda log: "../link.mcap",
        lambda log: "../folder/toy.mcap",
    ],
    ids=["relative", "by-detour", "absolute", "file-url", "link", "linked-folder"],
)
def test_a_copied_index_opens_no_log_outside_of_its_project(
    project: Path, opened: Opened, name_of: Callable[[Path], str]
) -> None:
    log = project.parent / "private" / "toy.mcap"
    index = copied(project, name_of(log))
    (project / "sessions").mkdir()
    (project / "link.mcap").symlink_to(log)
    (project / "folder").symlink_to(log.parent)
    opened.watch(log.parent)
    with pytest.raises(DatasetError) as error:
        Samples(index)
    assert opened.files == []
    message = str(error.value)
    assert "\n" not in message
    assert message.startswith(f"{index}: names {log} as the log of session toy")
    assert message.endswith(f"--sessions {log.parent}")


def test_logs_in_the_project_of_a_copied_index_are_opened(project: Path, opened: Opened) -> None:
    index = copied(project, "../recordings/toy.mcap")
    shutil.copytree(project.parent / "private", project / "recordings")
    opened.watch(project / "recordings")
    with Samples(index) as samples:
        assert list(samples.logs) == ["toy"]
    assert [Path(file).name for file in opened.files] == ["toy.mcap"]


def test_who_built_an_index_of_logs_elsewhere_is_never_asked(project: Path) -> None:
    log = toy_index(project.parent / "far").parent / "toy.mcap"
    build = ("bc-index", log, "--validation-share", "0")
    assert run(*build, cwd=project).returncode == 0
    (project / "other").mkdir()  # another process, in another folder
    code = f"from dataset import load; load({str(project / 'index')!r}).close()"
    assert run_code(code, cwd=project / "other").returncode == 0
    shutil.rmtree(project.parent / "cache")  # it may be removed at any time
    assert "you did not build the index" in run_code(code, cwd=project / "other").stderr
    assert run(*build, cwd=project).returncode == 0
    assert run_code(code, cwd=project / "other").returncode == 0


def test_the_folder_that_the_user_names_is_opened(project: Path) -> None:
    copied(project, "../../private/toy.mcap")
    export = ("bc-index", "export", "--lerobot", "exported")
    refused = run(*export, cwd=project)
    assert refused.returncode != 0
    assert one_line_of(refused).endswith(f"--sessions {project.parent / 'private'}")
    assert not (project / "exported").exists()
    done = run(*export, "--sessions", "../private", cwd=project)
    assert (project / "exported").is_dir(), done.stderr


def test_the_workbench_shows_why_a_log_is_not_opened(project: Path, opened: Opened) -> None:
    copied(project, "../../private/toy.mcap")
    opened.watch(project.parent / "private")
    with served(project) as bench:
        answer = bench.get("/index.altered")
        assert answer.status == 422
        assert "which is outside the index's project" in answer.text
    assert opened.files == []


def test_no_bucket_is_asked_for_a_log_of_a_copied_index(bucket: Bucket, tmp_path: Path) -> None:
    index = copied(tmp_path / "project", "s3://other/toy.mcap")
    asked: list[str] = []

    def note(handler: Any) -> bool:
        asked.append(handler.path)
        return False

    bucket.answer = note
    with pytest.raises(DatasetError, match=r"names s3://other/toy\.mcap as .* --sessions s3://other/$"):
        Samples(index)
    assert asked == []
