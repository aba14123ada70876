"""A folder that is kept in a store, and the copy of it here in which is worked: what differs goes down, or up.

Every file goes up on the condition that nobody has written it since it came down: of two machines that work on the
same folder, one is told. `.store.json`, in both places, tells of each file which object it is a copy of, and its
time of modification, which is the same wherever it is copied to.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import msgspec

from common.closeable import Closeable
from common.errors import NoSuchObjectError, ObjectChangedError, UserError
from common.files import PART_SUFFIX, atomic_file
from common.location import Url
from common.locks import lock, try_lock
from common.object_store import (
    ObjectFile,
    Seen,
    StoredObject,
    find_object,
    list_below,
    put_file,
    put_over,
    read_object,
    remove,
)
from common.users_cache import users_cache

_RECORD: Final = ".store.json"
_LOCK: Final = ".store.lock"
_MOST_BYTES: Final = 1 << 28
_PART_BYTES: Final = 1 << 23
_AT_ONCE: Final = 8  # files


class _Copy(msgspec.Struct, frozen=True):
    """A file that is the same in both places."""

    size: int
    mtime_ns: int
    e_tag: str
    version: str | None = None

    @property
    def seen(self) -> Seen:
        return Seen(self.e_tag, self.version)


class _Record(msgspec.Struct, frozen=True):
    """The content of `.store.json`."""

    url: str = ""
    files: dict[str, _Copy] = {}


class StoredFolder(Closeable):
    """Use it as a context manager, or call `close()`. Raises UserError while another process here works in it, or
    with `waits`, waits for that."""

    def __init__(self, url: Url, here: Path | None = None, *, waits: bool = False) -> None:
        """`here` is by default a folder of its own in the user's cache."""
        self.url = url
        digest = hashlib.sha256(str(url).encode()).hexdigest()[:12]
        self.here = here or users_cache() / "folders" / digest / (url.name or url.bucket)
        self.here.mkdir(parents=True, exist_ok=True)
        self._stream = (self.here / _LOCK).open("ab")
        if waits:
            lock(self._stream)
        elif not try_lock(self._stream):
            self._stream.close()
            raise UserError(f"{url}: another process of this machine works on it; wait until that is done")
        record = _record_in(self.here)
        self._copies = record.files if record.url == str(url) else {}

    @staticmethod
    def is_copy(here: Path, url: Url) -> bool:
        """True for a folder that was brought from there, or sent there."""
        return _record_in(here).url == str(url)

    def close(self) -> None:
        self._stream.close()

    def bring(self, *, keeps_ours: bool = False) -> None:
        """Make the folder here hold what the other one does. What was changed here and never went up is lost; or,
        with `keeps_ours`, stays, if it was not changed there too.

        Raises UserError for a file that was, or whose name cannot be here; StoreError.
        """
        objects = {str(each.url).removeprefix(f"{self.url}/"): each for each in list_below(self.url)}
        record = objects.pop(_RECORD, None)
        times = _record_of((read_object(record.url, _MOST_BYTES) or b"") if record is not None else b"").files
        to_fetch: list[tuple[str, StoredObject]] = []
        for name, there in objects.items():
            if any(not part or part.startswith(".") or "\\" in part or ":" in part for part in name.split("/")):
                raise UserError(f"{there.url}: a name that no file here may have; remove it there")
            ours = self._copies.get(name)
            is_ours = ours is not None and ours.seen.name == there.version
            is_changed = self._is_changed(name)
            if keeps_ours and is_changed and ours is not None and not is_ours:
                raise UserError(
                    f"{there.url}: was changed there, and its copy {self.here / name} here; remove one of the two"
                )
            if not is_ours or (is_changed and not keeps_ours):
                to_fetch.append((name, there))
        for name in self._copies.keys() - objects.keys():
            if not (keeps_ours and self._is_changed(name)):
                (self.here / name).unlink(missing_ok=True)
            del self._copies[name]
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            fetching = [(name, pool.submit(self._fetch, name, there, times)) for name, there in to_fetch]
            for name, each in fetching:
                self._copies[name] = each.result()
        self._write_record()

    def forget(self, name: str) -> None:
        """Remove a file here that is not there, and never was."""
        if name not in self._copies:
            (self.here / name).unlink(missing_ok=True)

    def send(self, first: Sequence[str] = ()) -> bool:
        """Make the other folder hold what this one does; True if anything had to be done. The files of `first` go
        up before all others, which go in the order in which they were written.

        Raises ObjectChangedError where another machine has written one of them: that and all behind it stay as
        they are there. StoreError.
        """
        files = {path.relative_to(self.here).as_posix(): path.stat() for path in self._files()}
        changed = [name for name in files if self._is_changed(name)]
        changed.sort(key=lambda name: (name not in first, files[name].st_mtime_ns, name))
        gone = sorted(self._copies.keys() - files.keys())
        try:
            for name in changed:
                copy = self._copies.get(name)
                status = files[name]
                seen = put_file(self.url.joined(name), self.here / name, copy.seen if copy is not None else None)
                self._copies[name] = _Copy(status.st_size, status.st_mtime_ns, seen.e_tag, seen.version)
            for name in gone:
                there = find_object(self.url.joined(name))
                if there is not None and there.version == self._copies[name].seen.name:
                    remove(there.url)
                del self._copies[name]
        finally:
            self._write_record()
        if changed or gone:
            put_over(self.url / _RECORD, (self.here / _RECORD).read_bytes())
        return bool(changed or gone)

    def _files(self) -> list[Path]:
        found = []
        for folder, folders, names in os.walk(self.here):
            folders[:] = [name for name in folders if not name.startswith(".") and not name.endswith(PART_SUFFIX)]
            found += [Path(folder, name) for name in names if not name.startswith(".")]
        return [path for path in found if not path.name.endswith(PART_SUFFIX) and not path.is_symlink()]

    def _is_changed(self, name: str) -> bool:
        """True for a file here that is not the copy it was."""
        copy = self._copies.get(name)
        try:
            status = (self.here / name).stat()
        except OSError:
            return copy is not None
        return copy is None or (status.st_size, status.st_mtime_ns) != (copy.size, copy.mtime_ns)

    def _fetch(self, name: str, there: StoredObject, times: dict[str, _Copy]) -> _Copy:
        path = self.here / name
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with (
                ObjectFile(there.url) as source,
                atomic_file(path, overwrite=True) as part,
                part.open("wb") as stream,
            ):
                starts = range(0, source.size, _PART_BYTES)
                for data in source.read_many((at, min(_PART_BYTES, source.size - at)) for at in starts):
                    stream.write(data)
        except NoSuchObjectError:
            raise ObjectChangedError(
                f"{there.url}: was removed while it was read; give the command again"
            ) from None
        told = times.get(name)
        if told is not None and told.seen.name == source.seen.name:
            os.utime(path, ns=(told.mtime_ns, told.mtime_ns))
        status = path.stat()
        return _Copy(status.st_size, status.st_mtime_ns, source.seen.e_tag, source.seen.version)

    def _write_record(self) -> None:
        record = _Record(str(self.url), self._copies)
        stored = json.dumps(msgspec.to_builtins(record), indent=1, sort_keys=True)
        with atomic_file(self.here / _RECORD, overwrite=True) as part:
            part.write_text(stored + "\n", encoding="utf-8")


def _record_in(folder: Path) -> _Record:
    path = folder / _RECORD
    return _record_of(path.read_bytes() if path.is_file() else b"")


def _record_of(stored: bytes) -> _Record:
    """Of what is none, an empty one: then all is copied again."""
    try:
        return msgspec.json.decode(stored, type=_Record)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return _Record()
