"""The user's cache: its files can be made or downloaded again, so the user may remove it at any time."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from common.errors import UserError


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
