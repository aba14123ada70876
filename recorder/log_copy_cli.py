"""`bc-log copy`: copies logs between this machine and a store, whole or not at all. Fingerprints are compared, and
nothing is replaced unasked.

To a store: the log is sent in parts, which become an object after the last one, if the name is still free. A
stopped upload begins again. From a store: NAME.mcap.XXXXXX.part grows on the disk. Its name depends on the
object's ETag, so that a stopped copy continues. All its CRCs are checked before it gets its name.
"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common import UserError
from common.command import DONE, FAILED, print_error, warn
from common.errors import ObjectChangedError, ObjectExistsError, StoreError, UsageError, as_user_error, counted
from common.files import PART_SUFFIX, atomic_file, make_folder, publish, refuse_existing
from common.interrupts import uninterrupted
from common.location import Location, Url
from common.location_flag import LocationFlag
from common.locks import try_lock
from common.object_file import MAX_READ_AHEAD, ObjectFile
from common.object_store import (
    OnBytes,
    find_object,
    put_new,
    put_over,
    put_parts,
    read_object,
    remove,
)
from common.output import print_message, print_next, print_result
from recorder.errors import LogError, recovery
from recorder.log.known_lag import copy_lag
from recorder.log.reader import Log
from recorder.log.tags import MAX_BYTES, tags_path
from recorder.log_flag import logs_at, named_log
from recorder.upkeep.check import is_whole


@dataclass(frozen=True)
class Copied:
    place: Location
    size: int  # bytes
    is_new: bool  # False: the same log was there already
    notice: str = ""  # about tags that were not copied


def copy_log(
    log: Location,
    to: Location,
    *,
    overwrite: bool = False,
    keeps_damaged: bool = False,
    on_bytes: OnBytes = lambda more: None,
) -> Copied:
    """Copy a finished log, its tags and its lag between this machine and a store, unless it is there already.

    Raises LogError for a log that is unfinished or damaged; with `keeps_damaged`, a download is kept for a
    recovery. Raises UserError if the name is taken (unless `overwrite`), or both places are of one kind;
    StoreError.
    """
    if isinstance(log, Path) and isinstance(to, Url):
        copied = _upload(log, to, overwrite, on_bytes)
    elif isinstance(log, Url) and isinstance(to, Path):
        copied = _download(log, to, overwrite, keeps_damaged, on_bytes)
    elif isinstance(log, Url):
        raise UserError(f"{log} and {to}: both in a store; copy it to this machine first")
    else:
        raise UserError(f"{log} and {to}: both are on this machine; copy with `cp`")
    copy_lag(log, to)
    return copied


def _upload(log: Path, url: Url, overwrite: bool, on_bytes: OnBytes) -> Copied:
    with Log(log) as opened:
        size, fingerprint = opened.size, opened.file_fingerprint
    if (stored := find_object(url)) is not None:
        if stored.size == size and _fingerprint(url) == fingerprint:
            on_bytes(size)
            return Copied(url, size, False, _upload_tags(log, url, overwrite))
        if not overwrite:
            raise ObjectExistsError(f"{url} exists already: choose another name, or give --force to replace it")
    if not is_whole(log):
        raise LogError(f"{log}: unfinished or damaged; run {recovery(log)} first")
    _put(log, url, size, fingerprint, overwrite, on_bytes)
    return Copied(url, size, True, _upload_tags(log, url, overwrite))


def _put(log: Path, url: Url, size: int, fingerprint: str, overwrite: bool, on_bytes: OnBytes) -> None:
    try:
        put_parts(url, _parts(log, on_bytes, None if overwrite else url), size)
    except StoreError:  # the object is complete if only the answer was lost, or if another machine has sent it
        if not _is_there(url, size, fingerprint):
            raise
    if _fingerprint(url) != fingerprint:
        remove(url)
        raise LogError(f"{log}: has changed while it was copied; give the command again")


def _is_there(url: Url, size: int, fingerprint: str) -> bool:
    """True if the complete log is at `url`."""
    stored = find_object(url)
    return stored is not None and stored.size == size and _fingerprint(url) == fingerprint


def _parts(log: Path, on_bytes: OnBytes, free: Url | None) -> Iterator[bytes]:
    """The bytes of a file. `free`: an object that must not exist after the last part."""
    with log.open("rb") as stream:
        while data := stream.read(MAX_READ_AHEAD):
            yield data
            on_bytes(len(data))
    if free is None:
        return
    with ThreadPoolExecutor(1) as other_thread:  # obstore uses this thread for the parts
        is_taken = other_thread.submit(find_object, free).result() is not None
    if is_taken:
        raise ObjectExistsError(f"{free} was written by another process at the same time; nothing was changed")


def _download(url: Url, path: Path, overwrite: bool, keeps_damaged: bool, on_bytes: OnBytes) -> Copied:
    with Log(url) as opened:
        fingerprint = opened.file_fingerprint
    with ObjectFile(url) as source:
        if path.is_file() and path.stat().st_size == source.size and _fingerprint(path) == fingerprint:
            on_bytes(source.size)
            return Copied(path, source.size, False, _download_tags(url, path, overwrite))
        refuse_existing(path, overwrite)
        make_folder(path.parent)
        token = hashlib.sha256(f"{url} {source.e_tag} {source.size}".encode()).hexdigest()[:6]
        part = path.with_name(f"{path.name}.{token}{PART_SUFFIX}")
        try:
            with part.open("ab") as stream:
                if not try_lock(stream):
                    raise UserError(f"{part}: is being written by another copy")
                begun = min(stream.tell(), source.size)
                stream.truncate(begun)
                on_bytes(begun)
                for data in source.read_from(begun):
                    stream.write(data)
                    on_bytes(len(data))
        except ObjectChangedError:  # this part cannot be continued
            part.unlink()
            raise
        if not is_whole(part) or _fingerprint(part) != fingerprint:
            if keeps_damaged:
                raise LogError(f"{url}: unfinished or damaged; {recovery(part)} makes a log of what came")
            part.unlink()
            copy = f"`bc-log copy {shlex.quote(str(url))} FOLDER`"
            raise LogError(f"{url}: unfinished or damaged; {copy} brings what there is")
        with uninterrupted():
            publish(part, path, overwrite)
    return Copied(path, source.size, True, _download_tags(url, path, overwrite))


def _fingerprint(place: Location) -> str:
    with Log(place) as log:
        return log.file_fingerprint


def _upload_tags(log: Path, url: Url, overwrite: bool) -> str:
    """Copy a log's tags; returns the reason if they are not copied."""
    file, stored = tags_path(log), tags_path(url)
    if not file.is_file():
        return ""
    tags = file.read_bytes()
    try:
        (put_over if overwrite else put_new)(stored, tags)
    except ObjectExistsError:
        if read_object(stored, MAX_BYTES) != tags:
            return _other_tags(file, stored)
    return ""


def _download_tags(url: Url, path: Path, overwrite: bool) -> str:
    stored, file = tags_path(url), tags_path(path)
    tags = read_object(stored, MAX_BYTES)
    if tags is None or (file.is_file() and file.read_bytes() == tags):
        return ""
    if file.exists() and not overwrite:
        return _other_tags(stored, file)
    with atomic_file(file, overwrite=overwrite) as part:
        part.write_bytes(tags)
    return ""


def _other_tags(tags: Location, target: Location) -> str:
    return f"{tags}: not copied, {target} has other tags; --force replaces them"


@dataclass(frozen=True)
class CopyLogs:
    """Copy logs and tags to or from a bucket, and compare every CRC. The same command
    continues a stopped download, and skips logs that are there."""

    places: Annotated[tuple[LocationFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...] TO")]
    """Logs or folders of logs, then the target: a folder, a URL, or a new name."""
    force: bool = False
    """Replace logs and tags of the same names."""

    def run(self) -> int:
        if len(self.places) < 2:
            raise UsageError("give the logs and where to: `bc-log copy sessions/lake.mcap s3://BUCKET/sessions`")
        logs, to = [named_log(place, takes_folders=True) for place in self.places[:-1]], self.places[-1]
        code = copy_logs(logs, to, overwrite=self.force)
        if code != FAILED:
            verb = "log check" if to.suffix == ".mcap" else "index --sessions"
            print_next(f"bc-{verb} {shlex.quote(str(to))}")
        return code


def copy_logs(places: Sequence[Location], to: Location, *, overwrite: bool = False, prog: str = "bc-log") -> int:
    """Copy logs and folders of logs, also after a failure; the worst of the exit codes."""
    from common.progress import progress_bar, progress_task
    from recorder.log.known_lag import lag_path
    from recorder.log.tags import tags_path

    pairs = _pairs(places, to)
    for log, target in pairs:
        if isinstance(log, Path) and isinstance(target, Path):
            files = [(log, target), (tags_path(log), tags_path(target)), (lag_path(log), lag_path(target))]
            copies = " && ".join(
                shlex.join(["cp", *map(str, pair)]) for pair in files if Path(str(pair[0])).is_file()
            )
            raise UserError(f"{log} and {target}: both are on this machine; copy with `{copies}`")
    from recorder.log_copy_cli import copy_log  # obstore, an extra

    codes = [DONE]
    with progress_bar() as bar:
        for number, (log, target) in enumerate(pairs, start=1):
            of_many = f" ({number} of {len(pairs)})" if len(pairs) > 1 else ""
            try:
                with progress_task(bar, f"copying {log.name}{of_many}, bytes", size_of(log)) as advance:
                    done = copy_log(log, target, overwrite=overwrite, keeps_damaged=True, on_bytes=advance)
            except OSError as error:
                codes.append(print_error(prog, _unreadable_or_full(log, target, error)))
                continue
            except Exception as error:
                codes.append(print_error(prog, as_user_error(log, error)))
                continue
            is_there = "" if done.is_new else ", was there already"
            print_result(f"{done.place}: {done.size / 1e6:,.1f} MB{is_there}")
            if done.notice:
                codes.append(warn(done.notice))
    if FAILED in codes and len(pairs) > 1:
        failed = codes.count(FAILED)
        print_message(f"{counted(failed, 'log')} of {len(pairs):,} not copied; the same command copies the rest")
    return FAILED if FAILED in codes else max(codes)


def _unreadable_or_full(log: Location, target: Location, error: OSError) -> UserError:
    """The error for a file of this machine that cannot be read or written."""
    if error.filename is None and isinstance(target, Path):
        return UserError(f"{target}: {error.strerror}; the same command continues")
    return UserError(f"{error.filename or log}: {error.strerror}")


def _pairs(places: Sequence[Location], to: Location) -> list[tuple[Location, Location]]:
    """Each log with the place of its copy."""
    logs: list[Location] = []
    for place in places:
        inside = [log for log in logs_at(place) if log.suffix == ".mcap" or log == place]
        if not inside:
            raise UserError(f"{place}: no finished log in it")
        logs += inside
    if to.suffix != ".mcap":
        pairs = [(log, to / log.name) for log in logs]
    elif len(logs) == 1:
        pairs = [(logs[0], to)]
    else:
        raise UsageError(f"{to}: one log, but {len(logs):,} are given; give a folder")
    names = [target.name for _, target in pairs]
    if twice := {name for name in names if names.count(name) > 1}:
        raise UsageError(f"{min(twice)}: two logs have this name; copy them to different folders")
    return pairs


def size_of(log: Location) -> int | None:
    """The bytes of a log; None if it does not exist. Raises StoreError."""
    if isinstance(log, Url):
        from common.object_store import find_object

        stored = find_object(log)
        return stored.size if stored else None
    return log.stat().st_size if log.is_file() else None
