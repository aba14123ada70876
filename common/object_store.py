"""Objects in a store, by obstore: listed, read by range, written whole and never over another one unasked.

Credentials and endpoint are those of the usual environment: AWS_ACCESS_KEY_ID and its neighbours or ~/.aws,
AWS_ENDPOINT_URL_S3, GOOGLE_APPLICATION_CREDENTIALS, AZURE_STORAGE_ACCOUNT_NAME and so on. obstore asks again,
later and later, where a store does not answer, answers 5xx, or is cut off. What it cannot mend is a StoreError.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeVar

from common.closeable import Closeable
from common.errors import NoSuchObjectError, ObjectChangedError, ObjectExistsError, StoreError, UserError
from common.location import Url
from common.random_access import Range
from common.s3_settings import obstore_s3_config

try:
    import obstore
    from obstore import exceptions as failures
    from obstore.store import from_url
except ImportError:
    raise UserError(
        "reading from a store needs obstore: `pip install behavioural-cloning-toolkit[scale]` brings it"
    ) from None

if TYPE_CHECKING:
    from obstore import GetOptions, ObjectMeta, PutMode, SuffixRange
    from obstore.store import ClientConfig, ObjectStore, RetryConfig

T = TypeVar("T")

MOST_IN_ONE_REQUEST: Final = 5 << 30
"""Bytes that S3 takes, or gives another name, in one request, and so on a condition."""

AT_ONCE: Final = 16
"""Requests that wait for their answers at a time: at 50 ms each, and 256 KB, some 80 MB/s."""

_SMALL: Final = 1 << 15  # a read of less brings its neighbours along: records lie side by side
_LARGEST: Final = 1 << 23  # read ahead of who reads a file through
_KEPT_BYTES: Final = 1 << 26
_KEPT: Final = 16  # stretches of a file that were read
_END: Final = 1 << 17  # of a file, read at once: a log of ours says there what is in it
_CUT_OFF: Final = 4  # times that is asked for what comes incomplete; obstore asks again for what does not come

# What is said where nobody gave any, and no role of the machine has answered either.
_NO_CREDENTIALS: Final = re.compile(
    r"169\.254\.169\.254|/latest/(api/token|meta-data)|metadata\.google\.internal|credential"
    r"|account must be specified|invalid access key",
    re.IGNORECASE,
)
_CREDENTIALS: Final = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (AWS_SKIP_SIGNATURE=true for a public bucket)",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS to the file of a key (GOOGLE_SKIP_SIGNATURE=true for a public bucket)",
    "az": "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY (AZURE_SKIP_SIGNATURE=true for a public one)",
}
_NO_RIGHT: Final = ("", " (AccessDenied)", " (AuthorizationPermissionMismatch)")
_RIGHTS: Final = {
    "s3": "the rights s3:GetObject and s3:ListBucket (without which S3 refuses what is not there), to write"
    " s3:PutObject and s3:DeleteObject, too",
    "gs": "the role Storage Object User",
    "az": "the role Storage Blob Data Contributor",
}

_asked_by = 0  # the process that has asked a store first
_is_hurried = False

# The first request of a process to a bucket shall fail within seconds; those of a training that has run for hours
# wait a minute for the network.
_IMPATIENT: Final[RetryConfig] = {
    "max_retries": 3,
    "retry_timeout": timedelta(seconds=10),
    "backoff": {"init_backoff": timedelta(seconds=0.1), "max_backoff": timedelta(seconds=1), "base": 2},
}
_PATIENT: Final[RetryConfig] = {
    "max_retries": 10,
    "retry_timeout": timedelta(seconds=90),
    "backoff": {"init_backoff": timedelta(seconds=0.1), "max_backoff": timedelta(seconds=15), "base": 2},
}
_TIMEOUT: Final = timedelta(minutes=5)  # of a request, with all of its bytes
_HURRIED: Final = timedelta(seconds=15)


@dataclass(frozen=True, order=True)
class StoredObject:
    """An object as a listing tells of it."""

    url: Url
    size: int  # bytes
    version: str  # ETag, without its quotation marks
    written_ns: int = 0  # since 1970; stores tell whole seconds


@dataclass(frozen=True)
class Seen:
    """By which an object is told from what takes its name later."""

    e_tag: str  # as the store writes it
    version: str | None = None  # of stores that go by that

    @property
    def name(self) -> str:
        """As in `StoredObject.version`."""
        return self.e_tag.strip('"')


class ObjectFile(Closeable):
    """An object, open for reading at any place, from any thread. It is one content that is read: if the object is
    replaced meanwhile, ObjectChangedError is raised."""

    is_remote = True

    def __init__(self, url: Url) -> None:
        """Raises NoSuchObjectError, or another StoreError. Reads the end of the object: one request, of Azure two,
        which is not asked for so many bytes from the end."""
        self.url = url
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, bytes] = OrderedDict()  # by where they begin
        self._read_from = self._read_to = -1  # the last stretch that was read
        self._ahead = _SMALL
        self._pool: ThreadPoolExecutor | None = None
        with _told(url):
            try:
                found, data = _got(url, {"suffix": _END})
                is_end = True
            except failures.NotSupportedError:
                found, data = _got(url, (0, _SMALL))
                is_end = len(data) == found["size"]
        self.size: int = found["size"]
        self.version: str = found["e_tag"] or ""
        self.seen = Seen(self.version, found["version"])
        self._keep(self.size - len(data) if is_end else 0, data)
        if not is_end:
            last = min(_END, self.size)
            self._keep(self.size - last, self._fetched(self.size - last, last))

    def close(self) -> None:
        self._kept.clear()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def grow(self) -> bool:
        """Objects do not grow."""
        return True

    def read(self, offset: int, length: int) -> bytes:
        if (known := self._known(offset, length)) is not None:
            return known
        with self._lock:
            is_next = (
                self._read_from <= offset <= self._read_to
            )  # a record may begin in what its head was read with
            self._ahead = min(2 * self._ahead, _LARGEST) if is_next else _SMALL
            wanted = min(max(length, self._ahead if is_next or length < _SMALL else 0), self.size - offset)
        data = self._fetched(offset, wanted)
        self._keep(offset, data)
        return data[:length]

    def read_many(self, ranges: Iterable[Range]) -> Iterator[bytes]:
        if self._pool is None:
            self._pool = ThreadPoolExecutor(AT_ONCE, "store")
        waiting: deque[Future[bytes]] = deque()
        for offset, length in ranges:
            known = self._known(offset, length)
            waiting.append(self._pool.submit(self._fetched, offset, length) if known is None else _done(known))
            if len(waiting) == 2 * AT_ONCE:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

    def read_alone(self, offset: int, length: int) -> bytes:
        return self._fetched(offset, length)

    def _fetched(self, offset: int, length: int) -> bytes:
        if length == 0:
            return b""
        with _told(self.url):
            for attempt in range(_CUT_OFF):
                try:
                    answer = obstore.get(
                        _store(self.url, True),
                        self.url.key,
                        options=_range_of(offset, length, self.version),
                    )
                    if (answer.meta["e_tag"] or "") != self.version or answer.meta["size"] != self.size:
                        self._changed()
                    data = answer.bytes().to_bytes()
                except failures.PreconditionError:
                    self._changed()
                except FileNotFoundError:
                    raise ObjectChangedError(f"{self.url}: was removed while it was read") from None
                except failures.GenericError as error:
                    if _is_out_of_range(str(error)):  # but it was within the object's size
                        self._changed()
                    if attempt == _CUT_OFF - 1 or not _is_cut_off(str(error)):
                        raise
                    continue
                if len(data) == length:
                    return data
        raise StoreError(f"{self.url}: bytes {offset:,} to {offset + length:,} came incomplete {_CUT_OFF} times")

    def _changed(self) -> NoReturn:
        raise ObjectChangedError(
            f"{self.url}: was replaced while it was read (another ETag or size than {self.version or self.size});"
            " give the command again"
        )

    def _known(self, offset: int, length: int) -> bytes | None:
        with self._lock:
            for start, data in self._kept.items():
                if start <= offset and offset + length <= start + len(data):
                    self._kept.move_to_end(start)
                    return data[offset - start : offset - start + length]
        return None

    def _keep(self, offset: int, data: bytes) -> None:
        with self._lock:
            self._kept[offset] = data
            self._read_from, self._read_to = offset, offset + len(data)
            while len(self._kept) > _KEPT or sum(map(len, self._kept.values())) > _KEPT_BYTES:
                self._kept.popitem(last=False)


def _got(url: Url, part: tuple[int, int] | SuffixRange) -> tuple[ObjectMeta, bytes]:
    """What a store tells of an object, and the bytes of a part of it, which may reach over its end. They are asked
    for again where they were cut off, or are fewer than the answer says."""
    for attempt in range(_CUT_OFF):
        try:
            found = obstore.get(_store(url, False), url.key, options={"range": part})
            data = found.bytes().to_bytes()
        except failures.GenericError as error:
            if _is_out_of_range(str(error)):  # nothing is in it
                return obstore.head(_store(url, False), url.key), b""
            if attempt == _CUT_OFF - 1 or not _is_cut_off(str(error)):
                raise
            continue
        if len(data) == found.range[1] - found.range[0]:
            return found.meta, data
    raise StoreError(f"{url}: came incomplete {_CUT_OFF} times")


def list_objects(folder: Url) -> list[StoredObject]:
    """The objects right in a folder, by name. One request for a thousand names. Raises StoreError."""
    with _told(folder):
        found = _again_if_cut_off(
            lambda: obstore.list_with_delimiter(_store(folder, False), folder.key or None)["objects"]
        )
    return sorted(_stored_object(folder, each) for each in found)


def list_below(folder: Url) -> list[StoredObject]:
    """The objects in a folder and in those within it, by name. Raises StoreError."""
    with _told(folder):
        found = _again_if_cut_off(
            lambda: list(itertools.chain.from_iterable(obstore.list(_store(folder, False), folder.key or None)))
        )
    return sorted(_stored_object(folder, each) for each in found)


def find_object(url: Url) -> StoredObject | None:
    """What a store tells of an object; None if there is none. Raises StoreError."""
    with _told(url):
        try:
            found = obstore.head(_store(url, False), url.key)
        except FileNotFoundError as error:
            if _is_no_bucket(str(error)):
                raise
            return None
    return _stored_object(url, found)


def _stored_object(place: Url, found: ObjectMeta) -> StoredObject:
    """An object in the bucket of `place`."""
    written_ns = int(found["last_modified"].timestamp()) * 1_000_000_000
    return StoredObject(Url(place.scheme, place.bucket, found["path"]), found["size"], _version(found), written_ns)


def _version(found: ObjectMeta) -> str:
    """An object's ETag, without the quotation marks, which Azure leaves out in listings."""
    return (found["e_tag"] or "").strip('"')


def read_object(url: Url, max_bytes: int) -> bytes | None:
    """All of a small object; None if there is none. Raises StoreError, also for one that is larger."""
    with _told(url):
        try:
            found, data = _got(url, (0, max_bytes))
        except FileNotFoundError as error:
            if _is_no_bucket(str(error)):
                raise
            return None
    if found["size"] > max_bytes:
        raise StoreError(f"{url}: larger than {max_bytes:,} bytes")
    return data


def put_new(url: Url, data: bytes) -> None:
    """Write a small object, whole or not at all. Raises ObjectExistsError where there is one of this name."""
    with _told(url):
        obstore.put(_store(url, True), url.key, data, mode="create")


def put_over(url: Url, data: bytes) -> None:
    """Write a small object, whole or not at all, over whatever had its name."""
    with _told(url):
        obstore.put(_store(url, True), url.key, data)


def put_file(url: Url, file: Path, seen: Seen | None) -> Seen:
    """Write a file, whole or not at all, over the object that was `seen` last; None: where there is none.

    Raises ObjectChangedError where there is another one, which stays; StoreError, also for a file of more than
    5 GB.
    """
    if (size := file.stat().st_size) > MOST_IN_ONE_REQUEST:
        raise StoreError(f"{url}: {size:,} bytes are more than a store takes at once")
    there = find_object(url) if seen is not None else None  # not every store knows the condition
    with _told(url):
        try:
            mode: PutMode = "create"
            if seen is not None:
                if there is None or there.version != seen.name:
                    raise failures.PreconditionError
                mode = {"e_tag": seen.e_tag}
                if seen.version is not None:
                    mode["version"] = seen.version
            made = obstore.put(_store(url, True), url.key, file, mode=mode, use_multipart=False)
        except (failures.PreconditionError, failures.AlreadyExistsError):
            if (ours := _seen_if_same(url, file)) is not None:  # by this very call, and the answer was lost
                return ours
            raise ObjectChangedError(f"{url}: was written by another machine meanwhile; that stays") from None
    return Seen(made["e_tag"] or "", made["version"])


def _seen_if_same(url: Url, file: Path) -> Seen | None:
    """Which object this is, if it has the bytes of the file. Raises StoreError."""
    with ObjectFile(url) as there, file.open("rb") as here:
        parts = there.read_many((at, min(_LARGEST, there.size - at)) for at in range(0, there.size, _LARGEST))
        is_same = all(data == here.read(len(data)) for data in parts) and not here.read(1)
        return there.seen if is_same else None


def put_parts(url: Url, parts: Iterable[bytes], size: int) -> None:
    """Write an object of `size` bytes in parts, several at once; it appears whole or not at all, over whatever had
    its name. Raises StoreError, also where it has appeared and the answer to that was lost."""
    part_bytes = max(_LARGEST, -(-size // 9000))  # a store takes 10,000 parts
    has_begun = False

    def given() -> Iterator[bytes]:
        nonlocal has_begun
        has_begun = True
        yield from parts

    def put() -> None:
        obstore.put(
            _store(url, True), url.key, given(), use_multipart=True, chunk_size=part_bytes, max_concurrency=4
        )

    with _told(url):
        _again_if_cut_off(put, lambda: not has_begun)


def name_new(made: Url, url: Url) -> None:
    """Give an object another name in its bucket, in the store itself. Raises ObjectExistsError where that is
    taken, also by this very call if the answer was lost: then, and where anything else is raised, it keeps the one
    it has."""
    with _told(url):
        _again_if_cut_off(lambda: obstore.copy(_store(url, True), made.key, url.key, overwrite=False))
    remove(made)


def remove(url: Url) -> None:
    """See to it that there is no such object. Raises StoreError."""
    with _told(url), contextlib.suppress(FileNotFoundError):
        obstore.delete(_store(url, True), url.key)


def _again_if_cut_off(ask: Callable[[], T], may_ask: Callable[[], bool] = lambda: True) -> T:
    """What a store answers; asked again where the answer came incomplete, as long as that makes no difference."""
    for _ in range(_CUT_OFF - 1):
        try:
            return ask()
        except failures.GenericError as error:
            if not (_is_cut_off(str(error)) and may_ask()):
                raise
    return ask()


def _range_of(offset: int, length: int, version: str) -> GetOptions:
    options: GetOptions = {"range": (offset, offset + length)}
    if version:
        options["if_match"] = version
    return options


def _done(data: bytes) -> Future[bytes]:
    future: Future[bytes] = Future()
    future.set_result(data)
    return future


def forget_stores() -> None:
    """Read the environment and the configuration again when a store is next asked."""
    _bucket.cache_clear()


def _store(url: Url, is_patient: bool) -> ObjectStore:
    if _asked_by not in (0, os.getpid()):  # obstore's threads are not in it: it would wait forever
        raise StoreError(
            f"{url}: cannot be read in a process that was forked from one which has read from a store; start it"
            ' anew (a DataLoader: multiprocessing_context="spawn")'
        )
    _note_process()
    return _bucket(url.scheme, url.bucket, is_patient and not _is_hurried, _HURRIED if _is_hurried else _TIMEOUT)


def _note_process() -> None:
    global _asked_by
    _asked_by = os.getpid()


@cache
def _bucket(scheme: str, bucket: str, is_patient: bool, timeout: timedelta) -> ObjectStore:
    config: dict[str, Any] = obstore_s3_config() if scheme == "s3" else {}
    client: ClientConfig = {
        "timeout": timeout,
        "connect_timeout": timedelta(seconds=5),
        "allow_http": True,  # as the endpoint that a person names has it; those of the three are https://
    }
    store: ObjectStore = from_url(
        f"{scheme}://{bucket}",
        config=config,  # type: ignore[call-overload]  # of the store that the scheme names
        client_options=client,
        retry_config=_PATIENT if is_patient else _IMPATIENT,
    )
    return store


@contextlib.contextmanager
def hurried() -> Iterator[None]:
    """Let every request of this process fail within seconds: people wait for what a server of pages reads."""
    global _is_hurried
    before, _is_hurried = _is_hurried, True
    try:
        yield
    finally:
        _is_hurried = before


@contextlib.contextmanager
def _told(url: Url) -> Iterator[None]:
    """Make one line of what obstore raises, which is several of what its layers say."""
    try:
        yield
    except (failures.BaseError, FileNotFoundError) as error:  # of what is not there, it raises Python's own
        raise as_told(url, error, " ".join(str(error).split())) from None


def _is_out_of_range(text: str) -> bool:
    return "416 Range Not Satisfiable" in text or "InvalidRange" in text


def _is_cut_off(text: str) -> bool:
    return "response body" in text or "invalid list response" in text or "invalid multipart response" in text


def _is_no_bucket(text: str) -> bool:
    return "NoSuchBucket" in text or "ContainerNotFound" in text or "specified bucket does not exist" in text


def as_told(url: Url, error: Exception, text: str) -> StoreError:
    """The error to raise, in one line, for what a store's client has raised, and says in `text`."""
    bucket = f"{url.scheme}://{url.bucket}"
    if isinstance(error, failures.AlreadyExistsError):
        return ObjectExistsError(f"{url} exists already: choose another name, or give --force to replace it")
    if _is_no_bucket(text):
        return NoSuchObjectError(f"{bucket}: no such bucket{_endpoint()}; give the name of one that is there")
    if "NoSuchUpload" in text:
        return StoreError(f"{url}: the store has given the upload up{_endpoint()}; give the command again")
    if isinstance(error, FileNotFoundError):
        return NoSuchObjectError(f"{url}: no such object; `bc-log ls {url.parent}` lists what is there")
    if _NO_CREDENTIALS.search(text):
        return StoreError(f"{bucket}: no credentials that can be used: set {_CREDENTIALS[url.scheme]}")
    if "redirect" in text.lower() or "AuthorizationHeaderMalformed" in text or "IncorrectEndpoint" in text:
        return StoreError(f"{bucket}: lies in another region: set AWS_REGION (or AWS_ENDPOINT_URL_S3)")
    if "RequestTimeTooSkewed" in text:
        return StoreError(f"{bucket}: refused, because this machine's clock is wrong; set it")
    is_refused = isinstance(error, failures.PermissionDeniedError | failures.UnauthenticatedError)
    if is_refused or "403 Forbidden" in text:  # a listing that is refused is a GenericError
        rights = f"; they need {_RIGHTS[url.scheme]}" if _code(text) in _NO_RIGHT else ""
        return StoreError(f"{url}: the store refuses that to these credentials{_code(text)}{rights}")
    if isinstance(error, failures.NotSupportedError) or "NotImplemented" in text:
        return StoreError(f"{url}: the store does not know what was asked of it{_code(text)}")
    return StoreError(f"{url}: {_reason(text)}{_endpoint()}")


def _code(text: str) -> str:
    found = re.search(r"<Code>(\w+)</Code>", text)
    return f" ({found[1]})" if found else ""


def _endpoint() -> str:
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    return f" (endpoint {endpoint})" if endpoint else ""


def _reason(text: str) -> str:
    status = re.search(r"[Ss]erver returned non-2xx status code: (\d+ [A-Z][\w ]*?):", text)
    if status:
        return f"the store answers {status[1]}{_code(text)}"
    unreachable = ("refused", "error trying to connect", "dns", "could not connect", "connect timeout")
    if "onnect" in text and any(each in text.lower() for each in unreachable):
        return "the store cannot be reached"
    if _is_cut_off(text) or "Connection was closed" in text:
        return "the connection to the store was cut, again and again; give the command again"
    plain = text.partition(" Debug source:")[0]
    return f"the store does not answer as it should: {plain[:300]}"
