"""What a page waits for ends, and says why, also where it cannot even begin."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from logs import write_log
from toy import STEERING, road
from waiting import wait_until
from web.errors import WebError
from web.folders.cache_folder import CacheFolder
from web.logs.picture_checks import PictureChecks
from web.processes.predictions import Predictions
from web.processes.rerun_viewers import RerunViewers


@pytest.fixture
def no_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No folder for temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))


@pytest.mark.usefixtures("no_room")
def test_a_prediction_without_room_for_temporary_files(tmp_path: Path) -> None:
    predictions = Predictions(tmp_path / "cache")
    predictions.start("key", tmp_path / "a.mcap", "", tmp_path / "run", 1)
    asked = predictions.work.requested("key")
    assert asked is not None
    wait_until(lambda: asked.is_done)
    predictions.work.close()
    assert asked.problem == "it cannot be started: No such file or directory"


@pytest.mark.usefixtures("no_room")
def test_a_log_in_rerun_without_room_for_temporary_files(tmp_path: Path) -> None:
    with pytest.raises(WebError, match="Rerun cannot be started: No such file"):
        RerunViewers(CacheFolder(tmp_path / "cache")).open(tmp_path / "a.mcap", is_growing=False)


def test_a_bug_in_the_check_of_pictures_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> None:
        raise IndexError("nobody has thought of this")

    monkeypatch.setattr("web.logs.picture_checks.check_images", fails)
    log = write_log(tmp_path / "a.mcap", STEERING, road, cameras=["center"])
    checks = PictureChecks(tmp_path / "index", CacheFolder(tmp_path / "cache"))
    checks.start(log, "fingerprint")
    checking = checks.checking("fingerprint")
    assert checking is not None
    wait_until(lambda: checking.is_done)
    checks.close()
    assert "IndexError" in checking.problem
    assert "nobody has thought of this" in capsys.readouterr().err
