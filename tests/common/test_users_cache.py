"""The user's cache: where it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from common import UserError
from common.store_settings import store_settings
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
