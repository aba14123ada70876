"""The user's cache: its files can be made or downloaded again, so the user may remove it at any time."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

from common.errors import UserError
from common.location import Url


def users_cache() -> Path:
    """`BC_CACHE`, else `behavioural-cloning-toolkit` in the system's folder of caches (`XDG_CACHE_HOME`,
    ~/.cache). Raises UserError for a user without a home folder."""
    if cache := os.environ.get("BC_CACHE"):
        return Path(cache)
    if xdg_cache := os.environ.get("XDG_CACHE_HOME"):
        caches = Path(xdg_cache)
    elif sys.platform == "win32":
        caches = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    else:
        try:
            caches = Path.home() / ".cache"
        except RuntimeError:
            raise UserError("no home folder for the cache: set BC_CACHE to a folder") from None
    return caches / "behavioural-cloning-toolkit"


def cached_copy(url: Url, kind: str = "folders") -> Path:
    """The path for a copy of a store's folder, which need not exist. Each `kind` of user has its own copy."""
    digest = hashlib.sha256(str(url).encode()).hexdigest()[:12]
    return users_cache() / kind / digest / (url.name or url.bucket)
