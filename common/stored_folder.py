"""A folder in a store, and its local copy in which commands work. Only files that differ are transferred.

A file is uploaded only if the store still has the version that was downloaded: if two machines change the same
file, one gets an error. For line files (machines only append lines), the lines of both machines are kept.
`.store.json`, in both places, records the object of each file (`common.store_record`).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
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
    MAX_RECORD_BYTES,
    RECORD_NAME,
    Copy,
    StoreRecord,
    bytes_of,
    is_within,
    read_record,
    record_of,
    write_record,
)
from common.tasks import in_threads
from common.users_cache import cached_copy

if TYPE_CHECKING:
    from rich.progress import Progress

_LOCK: Final = ".store.lock"
_MAX_WRITERS: Final = 20  # machines that append lines to one file at the same time


class StoredFolder(Closeable):
    """Use it as a context manager, or call `close()`. If another process of this machine uses the local copy,
    raises UserError, or waits if `waits` is true."""

    def __init__(
        self, url: Url, local: Path | None = None, *, waits: bool = False, line_files: Collection[str] = ()
    ) -> None:
        """`local` is by default a folder in the user's cache. `line_files` are the names of files to which
        machines only append lines."""
        self.url = url
        self.local = local or cached_copy(url)
        self._line_files = line_files
        self.local.mkdir(parents=True, exist_ok=True)
        self._stream = (self.local / _LOCK).open("ab")
        if waits:
            lock(self._stream)
        elif not try_lock(self._stream):
            self._stream.close()
            raise UserError(f"{url}: another process on this machine is using it; wait until it has ended")
        record = read_record(self.local)
        self._record = record if record.url == str(url) else StoreRecord(str(url))
        self._copies = dict(self._record.files)

    def close(self) -> None:
        self._stream.close()

    def download(
        self,
        *,
        keeps_local: bool = False,
        objects: Iterable[StoredObject] | None = None,
        wanted: Collection[str] | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Make the local folder equal to the store's folder. Local changes that were not uploaded are lost; with
        `keeps_local` they are kept. Lines that were appended to a local line file are always kept.

        `objects` is a listing of the folder, if the caller has one. If `wanted` is given, only these files are
        downloaded; the others are recorded in `StoreRecord.left`. `progress` shows a bar during the download.

        Raises UserError if a file was changed both locally (with `keeps_local`) and in the store, or if a name is
        not allowed on this machine; StoreError if the store fails.
        """
        listed = list_below(self.url) if objects is None else objects
        objects_by_name = {entry.url.name_in(self.url): entry for entry in listed}
        record = objects_by_name.get(RECORD_NAME)
        # without hidden files, such as locks, which other programs may have uploaded
        stored = {name: entry for name, entry in objects_by_name.items() if not f"/{name}".count("/.")}
        differ = [name for name, entry in stored.items() if self._differs(name, entry, keeps_local=keeps_local)]
        for name in self._copies.keys() - stored.keys():
            is_kept = keeps_local or name in self._line_files
            if not (is_kept and self._is_changed(name)):
                (self.local / name).unlink(missing_ok=True)
            del self._copies[name]
        recorded: Mapping[str, Copy] = {**self._copies, **self._record.left}
        record_version = "" if record is None else record.version
        if differ and record is not None and record.version != self._record.record_version:
            recorded = record_of(read_object(record.url, MAX_RECORD_BYTES) or b"").files
        elif not differ:
            record_version = self._record.record_version
        downloads = [name for name in differ if wanted is None or name in wanted]
        size = sum(stored[name].size for name in downloads)
        with _bar(progress, f"downloading {self.url.name}, bytes", size) as on_bytes:
            calls = [(name, stored[name], recorded.get(name), on_bytes) for name in downloads]
            for number, copy in in_threads(self._download_file, calls):
                self._copies[downloads[number]] = copy
        left = {
            name: _record_entry(stored[name], recorded.get(name)) for name in set(differ).difference(downloads)
        }
        self._write_record(left, record_version)

    def remove_local(self, *names: str) -> None:
        """Remove local files that were never in the store. A name that ends in a slash is a folder."""
        for path in self._files():
            name = path.relative_to(self.local).as_posix()
            if name not in self._copies and any(_is_or_contains(place, name) for place in names):
                path.unlink()

    def upload(self, first: Sequence[str] = (), only: Collection[str] | None = None) -> bool:
        """Make the store's folder equal to the local folder. Returns True if they differed.

        The files of `first` are uploaded first, in this order; a name that ends in a slash is a folder, and its
        files are uploaded at the same time. The other files follow in the order in which they were written. At
        last, files that were removed locally are removed from the store. With `only`, only these files are
        uploaded, and none is removed.

        Raises ObjectChangedError if another machine has changed one of the files: neither this file nor the
        following ones are then uploaded. Raises StoreError if the store fails.
        """
        files = {path.relative_to(self.local).as_posix(): path.stat().st_mtime_ns for path in self._files()}
        changed = [name for name in files if self._is_changed(name) and (only is None or name in only)]
        changed.sort(key=lambda name: (files[name], name))
        groups = [[name for name in changed if _is_or_contains(place, name)] for place in first]
        groups += [[name] for name in changed if not any(_is_or_contains(place, name) for place in first)]
        removed = sorted(self._copies.keys() - files.keys()) if only is None else []
        try:
            for group in groups:
                list(in_threads(self._upload_file, [(name,) for name in group]))
            list(in_threads(self._remove, [(name,) for name in removed]))
        finally:
            left = {name: copy for name, copy in self._record.left.items() if name not in changed}
            self._write_record(left, self._record.record_version)
        if changed or removed:
            self._put_record(changed, removed)
        return bool(changed or removed)

    def _remove(self, name: str) -> None:
        stored = find_object(self.url.joined(name))
        if stored is not None and stored.version == _version_of(self._copies[name]).name:
            remove(stored.url)
        del self._copies[name]

    def _upload_file(self, name: str) -> None:
        path = self.local / name
        for attempt in range(_MAX_WRITERS + 1):
            status, copy = path.stat(), self._copies.get(name)
            with path.open("rb") as stream:
                sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
            try:
                version = put_file(self.url.joined(name), path, None if copy is None else _version_of(copy))
            except ObjectChangedError:
                if attempt == _MAX_WRITERS or name not in self._line_files:
                    raise
                self._copies[name] = self._download_file(name, StoredObject(self.url.joined(name), 0, ""), None)
                if not self._is_changed(name):  # the store already has all local lines
                    return
            else:
                self._copies[name] = _copy_of(status, version, sha256)
                return

    def _put_record(self, changed: Sequence[str], removed: Sequence[str]) -> None:
        """Write the uploaded files into the store's record; the entries of other machines stay."""
        recorded = record_of(read_object(self.url / RECORD_NAME, MAX_RECORD_BYTES) or b"").files
        uploaded = {name: self._copies[name] for name in changed}
        copies = {**self._copies, **self._record.left, **recorded, **uploaded}
        files = {name: copy for name, copy in copies.items() if name not in removed}
        put_over(self.url / RECORD_NAME, bytes_of(StoreRecord(str(self.url), files)))

    def _files(self) -> list[Path]:
        paths = []
        for folder, folders, names in os.walk(self.local):
            folders[:] = [name for name in folders if not name.startswith(".") and not name.endswith(PART_SUFFIX)]
            paths += [Path(folder, name) for name in names if not name.startswith(".")]
        return [path for path in paths if not path.name.endswith(PART_SUFFIX) and not path.is_symlink()]

    def _is_changed(self, name: str) -> bool:
        """True if the local file was changed or removed since it was downloaded or uploaded."""
        copy = self._copies.get(name)
        try:
            status = (self.local / name).stat()
        except OSError:
            return copy is not None
        return copy is None or (status.st_size, status.st_mtime_ns) != (copy.size, copy.mtime_ns)

    def _differs(self, name: str, stored: StoredObject, *, keeps_local: bool) -> bool:
        """True if the file has to be downloaded. Raises the UserErrors of `download`."""
        if not is_within(name):
            raise UserError(f"{stored.url}: no file on this machine can have this name; remove the object")
        copy = self._copies.get(name)
        is_same_version = copy is not None and _version_of(copy).name == stored.version
        is_changed = self._is_changed(name)
        if name in self._line_files:
            return not is_same_version or not (self.local / name).exists()
        if keeps_local and is_changed and copy is not None and not is_same_version:
            raise UserError(
                f"{stored.url}: was changed, and so was its copy {self.local / name}; remove one of the two"
            )
        return not is_same_version or (is_changed and not keeps_local)

    def _download_file(
        self, name: str, stored: StoredObject, recorded: Copy | None, on_bytes: OnBytes = lambda more: None
    ) -> Copy:
        """Download a file over the local one. For a line file, keep the local lines after the downloaded lines."""
        path = self.local / name
        path.parent.mkdir(parents=True, exist_ok=True)
        has_local_lines = name in self._line_files and path.exists() and self._is_changed(name)
        local_content = path.read_bytes() if has_local_lines else b""
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
                _append_lines(part, local_content)  # before the rename: a kill in between would lose the lines
        except NoSuchObjectError:
            raise ObjectChangedError(
                f"{stored.url}: was removed while it was read; give the command again"
            ) from None
        return _copy_of(status, source.version, content.hexdigest())

    def _write_record(self, left: dict[str, Copy], record_version: str) -> None:
        self._record = StoreRecord(str(self.url), dict(self._copies), left, record_version)
        write_record(self.local, self._record)


def _is_or_contains(file_or_folder: str, name: str) -> bool:
    return name == file_or_folder or (file_or_folder.endswith("/") and name.startswith(file_or_folder))


def _bar(progress: Progress | None, description: str, total: int) -> contextlib.AbstractContextManager[OnBytes]:
    """Show a progress bar while the block runs; yields the callback that advances it."""
    if progress is None or not total:
        return contextlib.nullcontext(lambda more: None)
    return progress_task(progress, description, total)


def _copy_of(status: os.stat_result, version: ObjectVersion, sha256: str) -> Copy:
    return Copy(status.st_size, status.st_mtime_ns, version.e_tag, version.version, sha256)


def _version_of(copy: Copy) -> ObjectVersion:
    return ObjectVersion(copy.e_tag, copy.version)


def _record_entry(stored: StoredObject, recorded: Copy | None) -> Copy:
    """The entry in the record for a file that was not downloaded."""
    if recorded is not None and _version_of(recorded).name == stored.version:
        return recorded
    return Copy(stored.size, stored.written_ns, stored.version)


def _append_lines(path: Path, more: bytes) -> None:
    """Append the lines of `more` that the file lacks."""
    content = path.read_bytes()
    lines = set(content.splitlines())
    missing = [line for line in more.splitlines() if line not in lines]
    if missing:
        end = b"" if not content or content.endswith(b"\n") else b"\n"
        with path.open("ab") as stream:
            stream.write(end + b"".join(line + b"\n" for line in missing))
