"""The limit on open files."""

from __future__ import annotations

import sys

if sys.platform != "win32":
    import resource

_OTHERS = 256  # libraries, sockets, and the like


def allow_open_files(count: int) -> None:
    """Raise the limit on open files, often 1,024 in all, for `count` more, as far as the system permits."""
    if sys.platform != "win32":
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = count + _OTHERS if hard == resource.RLIM_INFINITY else min(count + _OTHERS, hard)
        if wanted > soft != resource.RLIM_INFINITY:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
