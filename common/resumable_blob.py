"""Uploads of files to Azure, in blocks, that are resumed after a stop: on any machine, or after a crash.

Blocks that are in no blob yet lie under its name for a week, and the store lists them. Each is named by its number
and its SHA-256, so this file's blocks are recognized. They become the blob in one request, on condition that its
name is still free. obstore signs these requests with its own credentials and urllib3 sends them, because obstore
makes none of them itself.
"""

from __future__ import annotations

import base64
import hashlib
from datetime import timedelta
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Final
from urllib.parse import quote, urlsplit
from urllib.request import getproxies, proxy_bypass
from xml.etree import ElementTree

from common.errors import ObjectExistsError, StoreError, UserError
from common.location import Url
from common.parted_file import AT_ONCE, OnBytes, PartedFile
from common.store_connection import store_of
from common.store_errors import exceptions, obstore, store_error
from common.versions import install_line

try:
    import urllib3
except ImportError:
    raise UserError(f"copying 8 MB or more to az:// needs urllib3: `{install_line('scale')}` brings it") from None

_SIGNED_FOR: Final = timedelta(days=1)  # of all requests together; those of a longer upload are refused
_TRIES: Final = 10  # of each request, later and later: a minute without the network is waited for
_NUMBER_BYTES: Final = 4
_NAME_BYTES: Final = (
    _NUMBER_BYTES + hashlib.sha256().digest_size
)  # all names of a blob's blocks have to be as long
_REFUSED: Final = (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN)
_TAKEN: Final = (HTTPStatus.CONFLICT, HTTPStatus.PRECONDITION_FAILED)
_AGAIN: Final = (408, 429, 500, 502, 503, 504)


class ResumableBlob:
    """A file on its way to a name in Azure."""

    def __init__(self, url: Url, file: Path, part_bytes: int) -> None:
        """`part_bytes`: as of PartedFile."""
        self.url = url
        self._file = PartedFile(file, part_bytes)
        self._sent: dict[int, str] = {}  # names of blocks, by their numbers
        self._listed: list[str] = []
        self._links: dict[str, str] = {}  # where to, signed, by the method

    @property
    def left(self) -> int:
        """Bytes that are in the store, from which a later `send` goes on, now that this one has ended early."""
        return sum(map(self._file.length, self._sent))

    def can_send(self) -> bool:
        """False where these credentials sign nothing (a SAS token, none), or the store refuses what they sign. To
        be called first. Raises StoreError, also where another program's blocks have the name."""
        store = store_of(self.url, True)
        try:
            for method in ("GET", "PUT"):
                self._links[method] = obstore.sign(store, method, self.url.key, _SIGNED_FOR)  # type: ignore[call-overload]
        except (exceptions.BaseError, ValueError):
            return False
        self._http = _http(self._links["PUT"])
        for _ in range(_TRIES):
            answer = self._answer_of("GET", "comp=blocklist&blocklisttype=uncommitted")
            if answer.status in _REFUSED:
                return False
            try:
                self._listed = self._names_in(answer)
            except ElementTree.ParseError:  # half of one
                continue
            if any(len(base64.b64decode(name)) != _NAME_BYTES for name in self._listed):
                raise StoreError(
                    f"{self.url}: another program is sending something of that name, or was stopped: choose"
                    " another name; Azure drops what nobody goes on with after a week"
                )
            return True
        raise StoreError(f"{self.url}: the list of its blocks came incomplete {_TRIES} times")

    def send(self, *, overwrite: bool = False, on_bytes: OnBytes = lambda more: None) -> None:
        """Send what is not there yet, and give it its name. Raises ObjectExistsError where there is something of
        that name, unless `overwrite`; StoreError, also where only the answer was lost."""
        for name in self._listed:
            number = int.from_bytes(base64.b64decode(name)[:_NUMBER_BYTES], "big")
            if self._file.length(number) and name == _block_name(number, self._file.read(number)):
                self._sent[number] = name
                on_bytes(self._file.length(number))
        self._file.send_missing(self._sent, partial(self._send_block, on_bytes=on_bytes))
        if self._file.is_changed():
            raise self._file.changed_error()
        self._commit(overwrite)

    def _send_block(self, number: int, on_bytes: OnBytes) -> None:
        data = self._file.read(number)
        name = _block_name(number, data)
        md5 = base64.b64encode(hashlib.md5(data, usedforsecurity=False).digest()).decode()
        answer = self._answer_of("PUT", f"comp=block&blockid={quote(name, safe='')}", data, {"Content-MD5": md5})
        self._refuse_error(answer)
        self._sent[number] = name
        on_bytes(len(data))

    def _commit(self, overwrite: bool) -> None:
        blocks = "".join(f"<Uncommitted>{self._sent[number]}</Uncommitted>" for number in sorted(self._sent))
        condition = {} if overwrite else {"If-None-Match": "*"}
        answer = self._answer_of("PUT", "comp=blocklist", f"<BlockList>{blocks}</BlockList>".encode(), condition)
        if answer.status in _TAKEN or b"InvalidBlockList" in answer.data:
            self._sent = {}  # they are of no use, or gone
        if answer.status in _TAKEN:
            raise ObjectExistsError(
                f"{self.url} exists already: choose another name, or give --force to replace it"
            )
        if b"InvalidBlockList" in answer.data:
            raise StoreError(f"{self.url}: another process has ended the upload; give the command again")
        self._refuse_error(answer)

    def _names_in(self, answer: urllib3.BaseHTTPResponse) -> list[str]:
        """What a list of blocks names. Raises StoreError, ElementTree.ParseError."""
        if answer.status == HTTPStatus.NOT_FOUND and b"BlobNotFound" in answer.data:
            return []
        self._refuse_error(answer)
        listed = ElementTree.fromstring(answer.data).iterfind("UncommittedBlocks/Block/Name")
        return [name.text or "" for name in listed]

    def _answer_of(
        self, method: str, query: str, body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> urllib3.BaseHTTPResponse:
        """What the store answers. Raises StoreError where it does not, however often it is asked."""
        try:
            return self._http.request(method, f"{self._links[method]}&{query}", body=body, headers=headers)
        except urllib3.exceptions.MaxRetryError as error:  # its own text has the signature in it
            is_lost = isinstance(error.reason, urllib3.exceptions.NewConnectionError)
            text = "could not connect" if is_lost else "Connection was closed"
            raise store_error(self.url, error, text) from None

    def _refuse_error(self, answer: urllib3.BaseHTTPResponse) -> None:
        """Raise StoreError for an answer that is an error."""
        if answer.status >= HTTPStatus.BAD_REQUEST:
            body = " ".join(answer.data.decode(errors="replace").split())
            reason = answer.reason or "Error"  # a proxy's own status has no phrase that is known
            text = f"server returned non-2xx status code: {answer.status} {reason}: {body}"
            raise store_error(self.url, StoreError(text), text)


def _block_name(number: int, data: bytes) -> str:
    return base64.b64encode(number.to_bytes(_NUMBER_BYTES, "big") + hashlib.sha256(data).digest()).decode()


def _http(link: str) -> urllib3.PoolManager:
    """By the proxy that the environment names, as obstore's requests."""
    address = urlsplit(link)
    proxy = None if proxy_bypass(address.hostname or "") else getproxies().get(address.scheme)
    retries = urllib3.Retry(
        _TRIES,
        status_forcelist=_AGAIN,
        allowed_methods=None,
        backoff_factor=0.1,
        backoff_max=15,
        raise_on_status=False,
    )
    timeout = urllib3.Timeout(connect=10, read=90)
    if proxy:
        return urllib3.ProxyManager(proxy, maxsize=AT_ONCE, retries=retries, timeout=timeout)
    return urllib3.PoolManager(maxsize=AT_ONCE, retries=retries, timeout=timeout)
