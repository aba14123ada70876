"""The folder for what can be made, or fetched, again: it may be removed at any time."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def users_cache() -> Path:
    """`BC_CACHE`, else `behavioural-cloning-toolkit` where a system keeps caches (`XDG_CACHE_HOME`, ~/.cache)."""
    if given := os.environ.get("BC_CACHE"):
        return Path(given)
    if given := os.environ.get("XDG_CACHE_HOME"):
        above = Path(given)
    elif sys.platform == "win32":
        above = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    else:
        above = Path.home() / ".cache"
    return above / "behavioural-cloning-toolkit"
