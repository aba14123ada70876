"""Copy a folder whose files belong together, such as a run, to a store and back: whole or not at all.

`.store.json` in the store records the files with their versions and checksums. A copy begins with an empty record
and ends with the complete one, so a copy that was cut off is recognised and not taken for the whole folder.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from common.errors import ObjectExistsError, StoreError, UserError
from common.files import PART_SUFFIX, new_folder
from common.location import Url
from common.object_file import ObjectFile
from common.object_store import OnBytes, StoredObject, list_below, put_file, put_over, read_object
from common.progress import progress_bar, progress_task
from common.tasks import in_threads
from common.untrusted import json_as

if TYPE_CHECKING:
    from collections.abc import Mapping

_RECORD: Final = ".store.json"
_MAX_RECORD_BYTES: Final = 1 << 28
_MAX_ATTEMPTS: Final = 10  # for a file that changes while it is copied


class _Entry(msgspec.Struct, frozen=True):
    """A file, and the version of the object with the same content."""

    size: int  # bytes
    mtime_ns: int
    e_tag: str
    sha256: str = ""  # of the content; earlier versions of the toolkit did not write it


class _Record(msgspec.Struct, frozen=True):
    url: str = ""
    files: dict[str, _Entry] = {}


class FolderUpload:
    """Copies a folder to a store; again and again, if the folder grows."""

    def __init__(self, folder: Path, url: Url) -> None:
        self._folder = folder
        self.url = url
        self._versions: dict[str, str] = {}  # of the objects that this one has written

    def copy(self, *, overwrite: bool = False) -> bool:
        """Copy the files that the store lacks or has otherwise, in the order in which they were written: a copy
        that is cut off is then like a folder whose writer was killed. Returns False if there were none. No object
        is removed.

        Raises ObjectExistsError, before anything is copied, if an object that is not of an earlier call has
        another content (unless `overwrite`), or if there are only other objects; StoreError; OSError.
        """
        stored, record = stored_files(self.url), _read_record(self.url)
        recorded = {} if record is None else record.files
        files = {name: _entry(path) for name, path in local_files(self._folder).items()}
        if record is None and stored and stored.keys().isdisjoint(files):
            raise ObjectExistsError(
                f"{self.url} holds other files: give a new place, such as {self.url / self._folder.name}"
            )
        changed = []
        for name, file in files.items():
            if (there := stored.get(name)) is not None:
                if _has_content(there, recorded.get(name), file):
                    files[name] = msgspec.structs.replace(file, e_tag=there.version)
                    continue
                if not overwrite and self._versions.get(name) != there.version:
                    raise ObjectExistsError(
                        f"{self.url} exists already, with another {name}: choose another name, or give --force to"
                        " replace it"
                    )
            changed.append(name)
        if not changed and record is not None and record.files.keys() >= files.keys():
            return False
        if record is None:
            put_over(self.url / _RECORD, _bytes_of(_Record(str(self.url))))
        size = sum(files[name].size for name in changed)
        with progress_bar() as bar, progress_task(bar, f"copying {self._folder.name}, bytes", size) as on_bytes:
            for name in changed:
                files[name] = self._put(name, files[name], on_bytes)
        others = {name: entry for name, entry in recorded.items() if name in stored}
        put_over(self.url / _RECORD, _bytes_of(_Record(str(self.url), {**others, **files})))
        return True

    def _put(self, name: str, file: _Entry, on_bytes: OnBytes) -> _Entry:
        path = self._folder / name
        for _ in range(_MAX_ATTEMPTS):
            self._versions[name] = put_file(self.url / name, path)
            status = path.stat()
            if (status.st_size, status.st_mtime_ns) == (file.size, file.mtime_ns):
                on_bytes(file.size)
                return msgspec.structs.replace(file, e_tag=self._versions[name])
            file = _entry(path)
        raise UserError(f"{path}: changes while it is copied; give the command again")


def download_folder(url: Url, folder: Path, *, unfinished: bool = False) -> bool:
    """Copy a folder from a store. Returns False if `folder` has the same files already.

    Raises StoreError if the store fails, or if the folder's upload was not finished (unless `unfinished`);
    UserError if `folder` exists otherwise, or a name is not allowed on this machine.
    """
    stored, record = stored_files(url), _read_record(url)
    recorded = {} if record is None else record.files
    if not unfinished and record is not None and not _is_whole(stored, recorded):
        raise StoreError(
            f"{url}: its upload is not finished: wait for it, or give its `bc-copy` again; --unfinished brings"
            " what is there"
        )
    if folder.exists():
        local = {name: _entry(path) for name, path in local_files(folder).items()}
        if all(
            name in local and _has_content(there, recorded.get(name), local[name])
            for name, there in stored.items()
        ):
            return False
        raise UserError(
            f"{folder} exists already, with other files: give a new place, such as {folder / url.name}, or move it"
            " away"
        )
    size = sum(there.size for there in stored.values())
    with (
        new_folder(folder) as part,
        progress_bar() as bar,
        progress_task(bar, f"copying {folder.name}, bytes", size) as on_bytes,
    ):
        calls = [(there, part / name, recorded.get(name), on_bytes) for name, there in stored.items()]
        list(in_threads(_download_file, calls))
    return True


def _is_whole(stored: Mapping[str, StoredObject], recorded: Mapping[str, _Entry]) -> bool:
    return bool(recorded) and all(
        name in stored and stored[name].version == _version_of(entry) for name, entry in recorded.items()
    )


def _download_file(there: StoredObject, path: Path, recorded: _Entry | None, on_bytes: OnBytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    content = hashlib.sha256()
    with ObjectFile(there.url) as source, path.open("wb") as stream:
        for data in source.read_from():
            content.update(data)
            stream.write(data)
            on_bytes(len(data))
    mtime_ns = there.written_ns
    if recorded is not None and _version_of(recorded) == source.e_tag.strip('"'):
        if recorded.sha256 not in ("", content.hexdigest()):
            raise StoreError(f"{there.url}: damaged: its content has another checksum than when it was copied")
        mtime_ns = recorded.mtime_ns  # the newest run is the one with the newest weights
    os.utime(path, ns=(mtime_ns, mtime_ns))


def stored_files(url: Url) -> dict[str, StoredObject]:
    """The objects of a folder by their relative names, without hidden ones. Raises UserError for a name that no
    file of this machine can have."""
    files = {entry.url.name_in(url): entry for entry in list_below(url)}
    for name, entry in files.items():
        if any(part in ("", ".", "..") or "\\" in part or ":" in part for part in name.split("/")):
            raise UserError(f"{entry.url}: no file on this machine can have this name; remove the object")
    return {name: files[name] for name in _shown(files)}


def local_files(folder: Path) -> dict[str, Path]:
    """The files of a folder by their relative names, in the order in which they were written; without hidden and
    unfinished ones, and links."""
    paths = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    paths.sort(key=lambda path: (path.stat().st_mtime_ns, path))
    files = {path.relative_to(folder).as_posix(): path for path in paths}
    return {name: files[name] for name in _shown(files)}


def _shown(names: Iterable[str]) -> list[str]:
    return [
        name
        for name in names
        if not any(part.startswith(".") or part.endswith(PART_SUFFIX) for part in name.split("/"))
    ]


def _entry(path: Path) -> _Entry:
    status = path.stat()
    with path.open("rb") as stream:
        sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    return _Entry(status.st_size, status.st_mtime_ns, "", sha256)


def _has_content(there: StoredObject, recorded: _Entry | None, file: _Entry) -> bool:
    """True if an object has the content of a file. It is read only if the record does not have its checksum."""
    if there.size != file.size:
        return False
    if recorded is not None and recorded.sha256 and _version_of(recorded) == there.version:
        return recorded.sha256 == file.sha256
    content = hashlib.sha256()
    with ObjectFile(there.url) as source:
        for data in source.read_from():
            content.update(data)
    return content.hexdigest() == file.sha256


def _version_of(entry: _Entry) -> str:
    return entry.e_tag.strip('"')  # earlier versions recorded the quotation marks


def _read_record(url: Url) -> _Record | None:
    """The record of a folder; None if other programs have written the folder."""
    data = read_object(url / _RECORD, _MAX_RECORD_BYTES)
    return None if data is None else json_as(data, _Record) or _Record()


def _bytes_of(record: _Record) -> bytes:
    return (json.dumps(msgspec.to_builtins(record), indent=1, sort_keys=True) + "\n").encode()
