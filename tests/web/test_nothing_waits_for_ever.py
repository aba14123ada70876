"""What a page waits for ends, and says why, also where it cannot even begin."""

from __future__ import annotations

from pathlib import Path

from recorder import Log
from tests.helpers.logs import write_log
from tests.helpers.toy import STEERING, road
from tests.helpers.waiting import wait_until
from web.logs.session_stretches import PictureChecks
from web.processes.kept_work import KeptWork


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
