"""The cache of bc-web stays below its limit, and is its user's."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from web.folders import cache_folder
from web.folders.cache_folder import CacheFolder


def test_the_newest_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_folder, "_MAX_BYTES", 80_000)
    cache = CacheFolder(tmp_path)
    for number in range(200):
        cache.keep(f"picture {number}", bytes([number]) * 1000)
    cache.tidy()
    assert sum(path.stat().st_size for path in tmp_path.glob("*/*")) == 80_000
    assert [cache.find(f"picture {number}") is not None for number in (0, 50, 199)] == [False, False, True]
    assert cache.find("picture 199") == bytes([199]) * 1000


@pytest.mark.skipif(os.name != "posix", reason="Windows has no modes")
def test_other_users_cannot_read_it(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "web"
    for _ in range(2):
        CacheFolder(folder).keep("picture", b"jpeg")
        assert folder.stat().st_mode & 0o777 == 0o700
        folder.chmod(0o755)  # as an earlier version made it
