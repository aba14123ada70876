"""Who writes a file holds its lock: others can ask, wait, or turn away, and a killed process holds none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from common import UserError
from common.locks import is_being_written, lock, try_lock
from common.store_connection import store_settings
from common.users_cache import users_cache
from tests.helpers.driving import PATIENCE_S, environment

HOLDER = """
import sys
from common.locks import lock

with open(sys.argv[1], "ab") as stream:
    lock(stream)
    print("locked", flush=True)
    sys.stdin.read()
"""


def test_a_lock_is_had_once_and_given_back_with_its_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with path.open("ab") as first, path.open("ab") as second:
        assert try_lock(first)
        assert is_being_written(path)
        assert not try_lock(second)
        assert first.write(b"text") == 4  # and it is written where it would have been
        first.close()
        assert not is_being_written(path)
        assert try_lock(second)
        assert path.read_bytes() == b"text"
    assert not is_being_written(tmp_path / "missing")


def test_a_killed_process_holds_no_lock(tmp_path: Path) -> None:
    path = tmp_path / "file"
    line = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(line, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline().strip() == b"locked"
        with path.open("ab") as stream:
            assert is_being_written(path)
            assert not try_lock(stream)
            holder.kill()
            holder.wait(PATIENCE_S)
            lock(stream)
            assert is_being_written(path)
    assert not is_being_written(path)


def test_a_user_without_a_home_folder_names_the_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("HOME", "BC_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # as for a user that the system does not know
    with pytest.raises(UserError, match="no home folder for the cache: set BC_CACHE"):
        users_cache()
    assert "region" not in store_settings("s3")
    monkeypatch.setenv("BC_CACHE", str(tmp_path))
    assert users_cache() == tmp_path
