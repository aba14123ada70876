"""A folder that is kept in a store, and the local copy that commands work in: what differs is fetched or sent.

Every file is sent on the condition that nobody has written it since it was fetched: of two machines that work on
the same folder, one gets an error; but of files to which machines only add lines, those of both are kept.
`.store.json`, in both places, records which object each file is a copy of (`common.store_record`).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Final

from common.closeable import Closeable
from common.errors import NoSuchObjectError, ObjectChangedError, UserError
from common.files import PART_SUFFIX, atomic_file
from common.location import Url
from common.locks import lock, try_lock
from common.object_file import ObjectFile, ObjectVersion
from common.object_store import (
    OnBytes,
    StoredObject,
    find_object,
    list_below,
    put_file,
    put_over,
    read_object,
    remove,
)
from common.progress import progress_task
from common.store_record import (
    RECORD_NAME,
    Copy,
    StoreRecord,
    bytes_of,
    is_within,
    read_record,
    record_of,
    write_record,
)
from common.users_cache import cached_copy

if TYPE_CHECKING:
    from rich.progress import Progress

_LOCK: Final = ".store.lock"
_MAX_BYTES: Final = 1 << 28
_AT_ONCE: Final = 8  # files
_MAX_WRITERS: Final = 20  # that add lines to one file at the same time


class StoredFolder(Closeable):
    """Use it as a context manager, or call `close()`. Raises UserError while another process here works in it, or
    with `waits`, waits for that."""

    def __init__(
        self, url: Url, here: Path | None = None, *, waits: bool = False, lines: Collection[str] = ()
    ) -> None:
        """`here` is by default a folder of its own in the user's cache. `lines` are the names of files to which
        machines only add lines."""
        self.url = url
        self.here = here or cached_copy(url)
        self._lines = lines
        self.here.mkdir(parents=True, exist_ok=True)
        self._stream = (self.here / _LOCK).open("ab")
        if waits:
            lock(self._stream)
        elif not try_lock(self._stream):
            self._stream.close()
            raise UserError(f"{url}: another process on this machine is using it; wait until it has ended")
        record = read_record(self.here)
        self._record = record if record.url == str(url) else StoreRecord(str(url))
        self._copies = dict(self._record.files)

    def close(self) -> None:
        self._stream.close()

    def bring(
        self,
        *,
        keeps_ours: bool = False,
        objects: Iterable[StoredObject] | None = None,
        wanted: Collection[str] | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Make the local folder hold what the store's does. Local changes that were never sent are lost; with
        `keeps_ours` they stay, unless the file was changed in the store, too. Lines that were added here stay.

        `objects` is a listing of the folder, if the caller has one. Files that are not `wanted` are recorded
        (`StoreRecord.left`), and not fetched. `progress` gets a line while others are.

        Raises UserError for a file that was, or whose name cannot be here; StoreError.
        """
        listed = list_below(self.url) if objects is None else objects
        objects_by_name = {entry.url.name_in(self.url): entry for entry in listed}
        record = objects_by_name.get(RECORD_NAME)
        # without locks and the like, which other programs may have copied there
        stored = {name: entry for name, entry in objects_by_name.items() if not f"/{name}".count("/.")}
        differ = [name for name, entry in stored.items() if self._differs(name, entry, keeps_ours=keeps_ours)]
        for name in self._copies.keys() - stored.keys():
            is_ours = keeps_ours or name in self._lines
            if not (is_ours and self._is_changed(name)):
                (self.here / name).unlink(missing_ok=True)
            del self._copies[name]
        recorded: Mapping[str, Copy] = {**self._copies, **self._record.left}
        record_version = "" if record is None else record.version
        if differ and record is not None and record.version != self._record.record_version:
            recorded = record_of(read_object(record.url, _MAX_BYTES) or b"").files
        elif not differ:
            record_version = self._record.record_version
        fetched = [name for name in differ if wanted is None or name in wanted]
        size = sum(stored[name].size for name in fetched)
        bar = _line_of(progress, f"fetching {self.url.name}, bytes", size)
        with bar as on_bytes, ThreadPoolExecutor(_AT_ONCE) as pool:
            fetching = [
                (name, pool.submit(self._fetch, name, stored[name], recorded.get(name), on_bytes))
                for name in fetched
            ]
            for name, fetch in fetching:
                self._copies[name] = fetch.result()
        left = {name: _unfetched(stored[name], recorded.get(name)) for name in set(differ).difference(fetched)}
        self._write_record(left, record_version)

    def forget(self, *names: str) -> None:
        """Remove local files that never were in the store: by their names, or a folder's, with a slash."""
        for path in self._files():
            name = path.relative_to(self.here).as_posix()
            if name not in self._copies and any(_is_it_or_in_it(name, forgotten) for forgotten in names):
                path.unlink()

    def send(self, first: Sequence[str] = (), only: Collection[str] | None = None) -> bool:
        """Make the store's folder hold what the local one does; True if anything had to be done.

        The files of `first` go up before all others, one after the other; of a folder among them, with a slash,
        several at once. The others go in the order in which they were written. Last, those that are gone here go.
        With `only`, no others go up, and none is removed.

        Raises ObjectChangedError where another machine has written one of them: that and all behind it stay as
        they are there. StoreError.
        """
        files = {path.relative_to(self.here).as_posix(): path.stat().st_mtime_ns for path in self._files()}
        changed = [name for name in files if self._is_changed(name) and (only is None or name in only)]
        changed.sort(key=lambda name: (files[name], name))
        groups = [[name for name in changed if _is_it_or_in_it(name, place)] for place in first]
        groups += [[name] for name in changed if not any(_is_it_or_in_it(name, place) for place in first)]
        gone = sorted(self._copies.keys() - files.keys()) if only is None else []
        try:
            for group in groups:
                _do_at_once(self._put, group)
            _do_at_once(self._remove, gone)
        finally:
            left = {name: copy for name, copy in self._record.left.items() if name not in changed}
            self._write_record(left, self._record.record_version)
        if changed or gone:
            self._put_record(changed, gone)
        return bool(changed or gone)

    def _put(self, name: str) -> None:
        self._copies[name] = self._sent(name)

    def _remove(self, name: str) -> None:
        stored = find_object(self.url.joined(name))
        if stored is not None and stored.version == _version_of(self._copies[name]).name:
            remove(stored.url)
        del self._copies[name]

    def _sent(self, name: str) -> Copy:
        path = self.here / name
        for is_last in (*(False,) * _MAX_WRITERS, True):
            status, sha256 = path.stat(), _sha256_of(path)
            copy = self._copies.get(name)
            try:
                version = put_file(self.url.joined(name), path, None if copy is None else _version_of(copy))
            except ObjectChangedError:
                if is_last or name not in self._lines:
                    raise
                self._copies[name] = self._fetch(name, StoredObject(self.url.joined(name), 0, ""), None)
                if not self._is_changed(name):  # the lines that were added here are there already
                    return self._copies[name]
                continue
            return Copy(status.st_size, status.st_mtime_ns, version.e_tag, version.version, sha256)
        raise AssertionError

    def _put_record(self, changed: Sequence[str], gone: Sequence[str]) -> None:
        """Enter the files that were sent into the store's record; the entries of other machines stay."""
        entered = record_of(read_object(self.url / RECORD_NAME, _MAX_BYTES) or b"").files
        sent = {name: self._copies[name] for name in changed}
        copies = {**self._copies, **self._record.left, **entered, **sent}
        files = {name: copy for name, copy in copies.items() if name not in gone}
        put_over(self.url / RECORD_NAME, bytes_of(StoreRecord(str(self.url), files)))

    def _files(self) -> list[Path]:
        paths = []
        for folder, folders, names in os.walk(self.here):
            folders[:] = [name for name in folders if not name.startswith(".") and not name.endswith(PART_SUFFIX)]
            paths += [Path(folder, name) for name in names if not name.startswith(".")]
        return [path for path in paths if not path.name.endswith(PART_SUFFIX) and not path.is_symlink()]

    def _is_changed(self, name: str) -> bool:
        """True for a file here that is not the copy it was."""
        copy = self._copies.get(name)
        try:
            status = (self.here / name).stat()
        except OSError:
            return copy is not None
        return copy is None or (status.st_size, status.st_mtime_ns) != (copy.size, copy.mtime_ns)

    def _differs(self, name: str, stored: StoredObject, *, keeps_ours: bool) -> bool:
        """True if a file has to be fetched for the local folder to hold it. Raises UserError as `bring` does."""
        if not is_within(name):
            raise UserError(f"{stored.url}: no file on this machine can have this name; remove it there")
        ours = self._copies.get(name)
        is_ours = ours is not None and _version_of(ours).name == stored.version
        is_changed = self._is_changed(name)
        if name in self._lines:
            return not is_ours or not (self.here / name).exists()
        if keeps_ours and is_changed and ours is not None and not is_ours:
            raise UserError(
                f"{stored.url}: was changed, and so was its copy {self.here / name}; remove one of the two"
            )
        return not is_ours or (is_changed and not keeps_ours)

    def _fetch(
        self, name: str, stored: StoredObject, recorded: Copy | None, on_bytes: OnBytes = lambda more: None
    ) -> Copy:
        """Fetch a file over what is here; of one of lines, those that were added here stay behind those there."""
        path = self.here / name
        path.parent.mkdir(parents=True, exist_ok=True)
        is_added_to = name in self._lines and path.exists() and self._is_changed(name)
        ours = path.read_bytes() if is_added_to else b""
        content = hashlib.sha256()
        try:
            with ObjectFile(stored.url) as source, atomic_file(path, overwrite=True) as part:
                with part.open("wb") as stream:
                    for data in source.read_from():
                        content.update(data)
                        stream.write(data)
                        on_bytes(len(data))
                if recorded is not None and _version_of(recorded).name == source.version.name:
                    os.utime(part, ns=(recorded.mtime_ns, recorded.mtime_ns))
                elif stored.written_ns:
                    os.utime(part, ns=(stored.written_ns, stored.written_ns))
                status = part.stat()
                _add_lines(part, ours)  # before it has its name: a kill between the two would lose them
        except NoSuchObjectError:
            raise ObjectChangedError(
                f"{stored.url}: was removed while it was read; give the command again"
            ) from None
        return Copy(
            status.st_size,
            status.st_mtime_ns,
            source.version.e_tag,
            source.version.version,
            content.hexdigest(),
        )

    def _write_record(self, left: dict[str, Copy], record_version: str) -> None:
        self._record = StoreRecord(str(self.url), dict(self._copies), left, record_version)
        write_record(self.here, self._record)


def _do_at_once(do: Callable[[str], None], names: Sequence[str]) -> None:
    """Raises what one of the calls does; those that have not begun are not made then."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        try:
            list(pool.map(do, names))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _is_it_or_in_it(name: str, file_or_folder: str) -> bool:
    return name == file_or_folder or (file_or_folder.endswith("/") and name.startswith(file_or_folder))


def _line_of(
    progress: Progress | None, description: str, total: int
) -> contextlib.AbstractContextManager[OnBytes]:
    """Show a line of a progress bar while the block runs; yields the callback that advances it."""
    if progress is None or not total:
        return contextlib.nullcontext(lambda more: None)
    return progress_task(progress, description, total)


def _version_of(copy: Copy) -> ObjectVersion:
    return ObjectVersion(copy.e_tag, copy.version)


def _unfetched(stored: StoredObject, recorded: Copy | None) -> Copy:
    """The record's entry of a file that was not fetched."""
    if recorded is not None and _version_of(recorded).name == stored.version:
        return recorded
    return Copy(stored.size, stored.written_ns, stored.version)


def _sha256_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _add_lines(path: Path, ours: bytes) -> None:
    """Put the lines of `ours` that a file has not at its end."""
    theirs = path.read_bytes()
    lines = set(theirs.splitlines())
    added = [line for line in ours.splitlines() if line not in lines]
    if added:
        end = b"" if not theirs or theirs.endswith(b"\n") else b"\n"
        with path.open("ab") as stream:
            stream.write(end + b"".join(line + b"\n" for line in added))
