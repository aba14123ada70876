"""List, read and write objects in a store, with obstore. Writes are atomic, and replace an object only on request.

Raises StoreError if the store does not support a request, or if the request still fails after obstore's retries.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from common.errors import StoreError
from common.location import Url
from common.object_file import MAX_READ_AHEAD, again_if_cut_off, read_part
from common.store_connection import store_of
from common.store_errors import as_store_error, is_no_bucket, is_refused, obstore
from common.store_errors import exceptions as failures

if TYPE_CHECKING:
    from obstore import ObjectMeta, PutResult

OnBytes: TypeAlias = Callable[[int], object]
"""Called with the number of bytes transferred since the last call."""

_MAX_IN_ONE_REQUEST: Final = 5 << 30  # bytes, of S3
_AT_ONCE: Final = 4  # parts
_MAX_PARTS: Final = 9000  # of an object; stores allow 10,000 or more


@dataclass(frozen=True, order=True)
class StoredObject:
    """An object's entry in a listing."""

    url: Url
    size: int  # bytes
    version: str  # ETag, without its quotation marks
    written_ns: int = 0  # since 1970; stores give whole seconds


def list_objects(folder: Url) -> list[StoredObject]:
    """The objects directly in a folder, sorted by name. One request for a thousand names. Raises StoreError."""
    return _listed(
        folder, lambda: obstore.list_with_delimiter(store_of(folder, False), folder.key or None)["objects"]
    )


def list_below(folder: Url) -> list[StoredObject]:
    """The objects in a folder and its subfolders, sorted by name. Raises StoreError."""
    return _listed(folder, lambda: [*itertools.chain(*obstore.list(store_of(folder, False), folder.key or None))])


def _listed(folder: Url, request: Callable[[], Sequence[ObjectMeta]]) -> list[StoredObject]:
    with as_store_error(folder):
        return sorted(_stored_object(folder, meta) for meta in again_if_cut_off(folder, request))


def find_object(url: Url) -> StoredObject | None:
    """An object's entry, as in a listing; None if the object does not exist. Raises StoreError."""
    with as_store_error(url):
        try:
            meta = obstore.head(store_of(url, False), url.key)
        except FileNotFoundError as error:
            if is_no_bucket(str(error)):
                raise
            return None
        except failures.BaseError as error:
            if is_refused(str(error)):
                read_part(url, (0, 1))  # raises an error with the reason: the answer to HEAD has no text
            raise
    return _stored_object(url, meta)


def _stored_object(place: Url, meta: ObjectMeta) -> StoredObject:
    """Convert obstore's metadata of an object in the bucket of `place`."""
    written_ns = int(meta["last_modified"].timestamp()) * 1_000_000_000
    version = (meta["e_tag"] or "").strip('"')  # Azure leaves the quotation marks out in listings
    return StoredObject(Url(place.scheme, place.bucket, meta["path"]), meta["size"], version, written_ns)


def read_object(url: Url, max_bytes: int) -> bytes | None:
    """All of a small object; None if it does not exist. Raises StoreError, also if it is larger than
    `max_bytes`."""
    with as_store_error(url):
        try:
            meta, data = read_part(url, (0, max_bytes))
        except FileNotFoundError as error:
            if is_no_bucket(str(error)):
                raise
            return None
    if meta["size"] > max_bytes:
        raise StoreError(f"{url}: larger than {max_bytes:,} bytes")
    return data


def put_new(url: Url, data: bytes) -> None:
    """Write a small object atomically. Raises ObjectExistsError if it already exists."""
    with as_store_error(url):
        obstore.put(store_of(url, True), url.key, data, mode="create")


def put_over(url: Url, data: bytes) -> None:
    """Write a small object atomically, replacing an existing one."""
    with as_store_error(url):
        obstore.put(store_of(url, True), url.key, data)


def put_file(url: Url, file: Path) -> str:
    """Upload a file atomically, replacing an existing object. Returns the object's version. Raises OSError."""
    is_large = file.stat().st_size > _MAX_IN_ONE_REQUEST
    with as_store_error(url):
        result = obstore.put(store_of(url, True), url.key, file, use_multipart=is_large)
    return (result["e_tag"] or "").strip('"')


def put_parts(url: Url, parts: Iterable[bytes], size: int) -> None:
    """Write an object of `size` bytes in parts, several at the same time. The write is atomic and replaces an
    existing object. Raises StoreError, also if the object was written but the store's answer was lost."""
    part_bytes = max(MAX_READ_AHEAD, -(-size // _MAX_PARTS))
    has_begun = False

    def read_parts() -> Iterator[bytes]:
        nonlocal has_begun
        has_begun = True
        yield from parts

    def put() -> PutResult:
        return obstore.put(
            store_of(url, True),
            url.key,
            read_parts(),
            use_multipart=True,
            chunk_size=part_bytes,
            max_concurrency=_AT_ONCE,
        )

    with as_store_error(url):
        again_if_cut_off(url, put, lambda: not has_begun)


def remove(url: Url) -> None:
    """Remove an object, if it exists. Raises StoreError."""
    with as_store_error(url), contextlib.suppress(FileNotFoundError):
        obstore.delete(store_of(url, True), url.key)
