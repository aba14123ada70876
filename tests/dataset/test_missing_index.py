"""An index that is not there, or a file in its place, is told by what was expected and the next command."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dataset.cli import main as bc_index
from model.cli import main as bc_train
from tests.helpers.udacity import call


@pytest.fixture
def cwd(index: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an index, its log, and a file that is neither."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(index.parent, tmp_path, dirs_exist_ok=True)
    Path("plain").write_text("no index")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("indx", "bc-train: indx: no index; did you mean index? build it with `bc-index --index indx`"),
        ("of people", "of people: no index; the indexes are index; build it with `bc-index --index 'of people'`"),
        ("plain", "plain: a file, not the folder of an index; `bc-index --index FOLDER` builds an index"),
        ("plain/index", "plain: a file, not the folder of an index"),
        ("none/index", "none/index: no index; did you mean index? build it with `bc-index --index none/index`"),
    ],
)
def test_training_builds_no_index_of_a_misspelt_name(
    cwd: Path, capsys: pytest.CaptureFixture[str], name: str, reported: str
) -> None:
    before = sorted(cwd.iterdir())
    assert call(bc_train, "--index", name, "--network", "small", "--epochs", 1, "--threads", 1) == 1
    printed = capsys.readouterr()
    assert (reported in printed.err, printed.out) == (True, "")
    assert sorted(cwd.iterdir()) == before


def test_a_file_is_no_place_for_an_index(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_index, "--sessions", cwd, "--index", "plain") == 1
    assert "plain: a file, not the folder of an index" in capsys.readouterr().err
    assert Path("plain").read_text() == "no index"


def test_a_run_or_a_folder_of_logs_is_no_place_for_an_index(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs, run = cwd / "logs", cwd / "run"
    run.mkdir()
    (run / "config.json").write_text("{}")
    logs.mkdir()
    next(cwd.rglob("*.mcap")).rename(logs / "a.mcap")
    for folder, content in (("run", "a run"), ("logs", "a folder of logs")):
        before = sorted((cwd / folder).iterdir())
        assert call(bc_index, "--sessions", logs, "--index", folder) == 1
        assert f"{folder}: {content}; an index needs its own folder" in capsys.readouterr().err
        assert call(bc_train, "--index", folder, "--network", "small", "--epochs", 1, "--threads", 1) == 1
        assert (
            f"{folder}: {content}, not an index; `bc-index --index FOLDER` builds an index"
            in capsys.readouterr().err
        )
        assert sorted((cwd / folder).iterdir()) == before


def test_a_file_is_no_folder_of_sessions(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_index, "--sessions", "plain") == 1
    assert "plain is a file: give the folder of the logs" in capsys.readouterr().err
