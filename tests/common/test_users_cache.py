"""The user's cache: where it is, and that it does not grow without end."""

from __future__ import annotations

from pathlib import Path

import pytest

from common import UserError
from common.allowed_places import AllowedPlaces, remember_places
from common.store_connection import store_settings
from common.users_cache import users_cache


def test_a_user_without_a_home_folder_names_the_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("HOME", "BC_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # as for a user that the system does not know
    with pytest.raises(UserError, match="no home folder for the cache: set BC_CACHE"):
        users_cache()
    assert "region" not in store_settings("s3")
    monkeypatch.setenv("BC_CACHE", str(tmp_path))
    assert users_cache() == tmp_path


def test_records_of_removed_indexes_are_forgotten(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("common.allowed_places.MAX_RECORDS", 3)
    project, logs = tmp_path / "project", tmp_path / "logs"
    for number in range(9):
        index = project / f"index-{number}"
        index.mkdir(parents=True)
        remember_places(index, project, [logs])
        if number:
            index.rmdir()
    remember_places(project, project, [logs])
    monkeypatch.setattr("common.allowed_places._remembered", {})  # as in another process
    assert len(list((tmp_path / "cache" / "built-here").iterdir())) == 2
    assert logs / "a.mcap" in AllowedPlaces(project / "index-0", project)
    assert logs / "a.mcap" not in AllowedPlaces(project / "index-1", project)
