"""The wheels of running processes: each driving process has a file in the user's cache while it lives."""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec

from common.locks import is_being_written, lock
from common.untrusted import read_bounded
from common.users_cache import users_cache

_MAX_BYTES: Final = 1 << 16
_MAX_START_S: Final = 60.0  # an older file without a lock belongs to a process that died


class OpenWheel(msgspec.Struct, frozen=True):
    """A driving process of this user that a page can connect to, on 127.0.0.1."""

    key: str
    port: int
    token: str  # of the header `Authorization: Bearer TOKEN`
    project: str  # the folder in which the process was started
    title: str
    log: str


def open_wheels(project: Path) -> list[OpenWheel]:
    """The wheels of processes that were started in the folder `project`, newest first."""
    wheels = []
    for path in _files():
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            if is_being_written(path):
                wheel = msgspec.json.decode(read_bounded(path, _MAX_BYTES), type=OpenWheel)
                if wheel.key == path.stem and wheel.project == str(project.absolute()):
                    wheels.append(wheel)
            elif time.time() - path.stat().st_mtime > _MAX_START_S:
                path.unlink()
    return sorted(wheels, key=lambda wheel: wheel.key, reverse=True)


def new_key() -> str:
    """A unique name for a wheel; names sort by time."""
    return f"{time.time_ns() // 1_000_000:013d}-{secrets.token_hex(4)}"


@contextlib.contextmanager
def announced(wheel: OpenWheel) -> Iterator[None]:
    """List a wheel until the context ends or the process dies. Without a cache folder, it is not listed."""
    path = _folder() / f"{wheel.key}.json"
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            stack.callback(path.unlink, missing_ok=True)  # after the file is closed: Windows removes no open files
            stream = stack.enter_context(os.fdopen(descriptor, "wb"))
            lock(stream)
            stream.write(msgspec.json.encode(wheel))
            stream.flush()
        yield


def _folder() -> Path:
    return users_cache() / "wheels"


def _files() -> list[Path]:
    with contextlib.suppress(OSError):
        return list(_folder().glob("*.json"))
    return []
