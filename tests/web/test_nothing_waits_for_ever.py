"""What a page waits for ends, and says why, also where it cannot even begin."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from recorder import Log
from tests.helpers.logs import write_log
from tests.helpers.toy import STEERING, road
from tests.helpers.waiting import wait_until
from web.errors import WebError
from web.folders.cache_folder import CacheFolder
from web.logs.picture_checks import PictureChecks
from web.processes.kept_work import KeptWork
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
    assert asked.problem == "the process does not start: No such file or directory"


@pytest.mark.usefixtures("no_room")
def test_a_log_in_rerun_without_room_for_temporary_files(tmp_path: Path) -> None:
    with pytest.raises(WebError, match="Rerun cannot be started: No such file"):
        RerunViewers(CacheFolder(tmp_path / "cache")).open(tmp_path / "a.mcap", is_growing=False)


def test_a_bug_in_a_process_is_said(tmp_path: Path) -> None:
    work = KeptWork(tmp_path / "cache", "web.processes.no_such_module", "stopped")
    work.start("key", 1, [])
    requested = work.requested("key")
    assert requested is not None
    wait_until(lambda: requested.is_done)
    work.close()
    assert requested.problem == "the process ended with exit code 1; try again"


def test_a_log_that_is_deleted_before_its_pictures_are_checked(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", STEERING, road, cameras=["center"])
    checks = PictureChecks(tmp_path / "index", tmp_path / "cache")
    with Log(path) as log:
        path.unlink()
        checks.start(log)
        checking = checks.work.requested(log.fingerprint)
        assert checking is not None
        wait_until(lambda: checking.is_done)
        assert not checks.are_checked(log)
    checks.work.close()
    assert "a.mcap" in checking.problem
