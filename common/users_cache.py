"""The folder for what can be made, or fetched, again: it may be removed at any time."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

from common.location import Url


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


def cached_copy(url: Url, kind: str = "folders") -> Path:
    """The place of a copy of a store's folder, whether or not there is one. `kind`: who works in it."""
    digest = hashlib.sha256(str(url).encode()).hexdigest()[:12]
    return users_cache() / kind / digest / (url.name or url.bucket)
