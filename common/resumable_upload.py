"""Multipart uploads of files to S3 that are resumed after a stop: on any machine, or after a crash.

Nothing is kept here for that: the store lists the unfinished uploads to a name, and the parts of each that have
arrived. An upload whose parts are the file's bytes, by their SHA-256, is resumed; others are somebody else's. The
object appears when it is whole, on condition that its name is still free. botocore does this, because obstore does
not give the id of its uploads. Azure's are in `common.resumable_blob`; uploads to Google are obstore's alone.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import http
import os
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, TypeVar

from common.errors import ObjectExistsError, StoreError, UserError
from common.interrupts import uninterrupted
from common.location import Url
from common.parted_file import AT_ONCE, OnBytes, PartedFile
from common.s3_settings import S3Settings, s3_settings
from common.store_errors import store_error
from common.versions import install_line

try:
    import botocore.session
    from botocore import UNSIGNED
    from botocore.config import Config
    from botocore.exceptions import BotoCoreError, ClientError
    from botocore.parsers import ResponseParserError
except ImportError:
    raise UserError(f"copying 8 MB or more to s3:// needs botocore: `{install_line('scale')}` brings it") from None

T = TypeVar("T")

_CHECKSUMS: Final = ("ETag", "ChecksumSHA256")  # of a part, as stores name them
_TRIES: Final = 10  # of each request, later and later: a minute without the network is waited for
_ALGORITHM: Final = "SHA256"
_LISTING_REFUSED: Final = (403, 405, 501)  # uploads may not be listed, or the store cannot


class _UploadGoneError(StoreError):
    """An upload was ended, or spoilt, by another process."""


class ResumableUpload:
    """A file on its way to a name in S3."""

    def __init__(self, url: Url, file: Path, part_bytes: int) -> None:
        """`part_bytes`: of each part but the last; more where there would be too many. Raises StoreError."""
        self.url = url
        self._file = PartedFile(file, part_bytes)
        self._sent: dict[int, dict[str, Any]] = {}  # by number, as complete_multipart_upload lists them
        self._id = ""
        self._stays = False
        with _translating_errors(url):
            self._client = _client(s3_settings(), url.bucket)
        self._names = {"Bucket": url.bucket, "Key": url.key}

    @property
    def left(self) -> int:
        """Bytes that are in the store, from which a later `send` goes on, now that this one has ended early."""
        return sum(map(self._file.length, self._sent)) if self._stays else 0

    def send(self, *, overwrite: bool = False, on_bytes: OnBytes = lambda more: None) -> None:
        """Send what is not there yet, and give it its name. Raises ObjectExistsError where there is something of
        that name, unless `overwrite`; StoreError, also where only the answer was lost."""
        try:
            with _translating_errors(self.url):
                self._find(on_bytes)
                if not self._id:
                    begin = partial(self._client.create_multipart_upload, **self._names, **_encryption())
                    self._id = _answer_of(begin, ChecksumAlgorithm=_ALGORITHM)["UploadId"]
                self._file.send_missing(self._sent, partial(self._send_part, on_bytes=on_bytes))
                self._complete(overwrite)
        except BaseException as error:
            if isinstance(error, ObjectExistsError | _UploadGoneError) or not self._sent:
                self._stays = False
            if not self._stays and self._id:
                # the first error says more than one of removing the upload
                with uninterrupted(), contextlib.suppress(StoreError), _translating_errors(self.url):
                    _abort(self._client, self.url, self._id)
            raise

    def _find(self, on_bytes: OnBytes) -> None:
        """Look for an upload that has sent some of this file, and nothing else."""
        try:
            uploads = _uploads(self._client, self.url)
            self._stays = True
            for upload in uploads:
                is_alike = upload.get("ChecksumAlgorithm", _ALGORITHM) == _ALGORITHM
                if is_alike and self._is_ours(upload["UploadId"], on_bytes):
                    self._id = upload["UploadId"]
                    return
        except ClientError as error:
            if _status_of(error) not in _LISTING_REFUSED:
                raise
            self._stays = False

    def _is_ours(self, upload_id: str, on_bytes: OnBytes) -> bool:
        """True if parts have come, and all are this file's. One of which none has come is as good as a new one,
        and may be another file's."""
        self._sent = {}
        try:
            listed = _pages(self._client, "list_parts", "Parts", **self._names, UploadId=upload_id)
        except ClientError as error:
            if _code_of(error) == "NoSuchUpload":  # finished a moment ago
                return False
            raise
        for part in listed:
            number = part["PartNumber"]
            if part["Size"] != self._file.length(number) or not _is_of(part, self._file.read(number)):
                on_bytes(-sum(map(self._file.length, self._sent)))
                self._sent = {}
                return False
            self._note(number, part)
            on_bytes(part["Size"])
        return bool(self._sent)

    def _send_part(self, number: int, on_bytes: OnBytes) -> None:
        data = self._file.read(number)
        send = partial(self._client.upload_part, **self._names, UploadId=self._id, PartNumber=number, Body=data)
        self._note(number, _answer_of(send, ChecksumSHA256=_sha256(data)))
        on_bytes(len(data))

    def _complete(self, overwrite: bool) -> None:
        if self._file.is_changed():
            self._stays = False
            raise self._file.changed_error()
        condition = {} if overwrite else {"IfNoneMatch": "*"}
        complete = partial(self._client.complete_multipart_upload, **self._names, **condition, UploadId=self._id)
        for tries_left in reversed(range(_TRIES)):
            parts = [self._sent[number] for number in sorted(self._sent)]
            try:
                _answer_of(complete, MultipartUpload={"Parts": parts})
                return
            except ClientError as error:
                if _code_of(error) == "InvalidRequest" and self._add_checksums():
                    continue
                if _code_of(error) != "InvalidPart" or not tries_left:
                    raise
                # perhaps a part has come once more, from another process, and has another ETag now
                if not self._is_ours(self._id, lambda more: None) or len(self._sent) < self._file.count:
                    raise

    def _add_checksums(self) -> bool:
        """Note the checksums that the store does not list, but wants to hear in the end, as SeaweedFS does. False
        if none is missing."""
        missing = [number for number, part in self._sent.items() if "ChecksumSHA256" not in part]
        for number in missing:
            self._sent[number]["ChecksumSHA256"] = _sha256(self._file.read(number))
        return bool(missing)

    def _note(self, number: int, answer: dict[str, Any]) -> None:
        checksums: dict[str, Any] = {name: answer[name] for name in _CHECKSUMS if name in answer}
        self._sent[number] = {"PartNumber": number, **checksums}


def remove_unfinished(url: Url) -> int:
    """Remove what uploads to a name have sent that are not finished, also of those that still go on. Returns how
    many there were. Raises StoreError."""
    with _translating_errors(url):
        client = _client(s3_settings(), url.bucket)
        uploads = _uploads(client, url)
        for upload in uploads:
            _abort(client, url, upload["UploadId"])
        return len(uploads)


def _uploads(client: Any, url: Url) -> list[dict[str, Any]]:
    """The uploads to this name that are not finished."""
    found = _pages(client, "list_multipart_uploads", "Uploads", Bucket=url.bucket, Prefix=url.key)
    return [upload for upload in found if upload["Key"] == url.key]


def _abort(client: Any, url: Url, upload_id: str) -> None:
    try:
        _answer_of(client.abort_multipart_upload, Bucket=url.bucket, Key=url.key, UploadId=upload_id)
    except ClientError as error:
        if _code_of(error) != "NoSuchUpload":
            raise


def _pages(client: Any, operation: str, name: str, **names: str) -> list[dict[str, Any]]:
    """All entries of a list that comes in pages."""
    pages = _answer_of(lambda: list(client.get_paginator(operation).paginate(**names)))
    return [entry for page in pages for entry in page.get(name, [])]


def _answer_of(request: Callable[..., T], **names: Any) -> T:
    """A store's answer. botocore repeats a request that gets none, or an error; this, one that gets half of it."""
    for _ in range(_TRIES - 1):
        try:
            return request(**names)
        except ResponseParserError:
            continue
    return request(**names)


def _is_of(part: dict[str, Any], data: bytes) -> bool:
    """True if a stored part has these bytes, as far as the store gives its checksum."""
    if "ChecksumSHA256" in part:
        return bool(part["ChecksumSHA256"] == _sha256(data))
    return bool(part["ETag"].strip('"') == hashlib.md5(data, usedforsecurity=False).hexdigest())


def _sha256(data: bytes) -> str:
    return base64.b64encode(hashlib.sha256(data).digest()).decode()


def _encryption() -> dict[str, str]:
    """The encryption to request, by the same environment variables as obstore's."""
    names = {"ServerSideEncryption": "AWS_SERVER_SIDE_ENCRYPTION", "SSEKMSKeyId": "AWS_SSE_KMS_KEY_ID"}
    return {name: os.environ[variable] for name, variable in names.items() if variable in os.environ}


@lru_cache(maxsize=4)
def _client(settings: S3Settings, bucket: str) -> Any:
    style = "virtual" if settings.is_virtual_hosted else "path"
    endpoint = settings.endpoint and settings.endpoint.replace(
        f"//{bucket}.", "//", 1
    )  # obstore's has the bucket in it
    return botocore.session.get_session().create_client(
        "s3",
        region_name=settings.region,
        endpoint_url=endpoint,
        aws_access_key_id=settings.access_key_id,
        aws_secret_access_key=settings.secret_access_key,
        aws_session_token=settings.session_token,
        config=Config(
            signature_version=UNSIGNED if settings.is_unsigned else None,
            s3={"addressing_style": style},
            retries={"mode": "standard", "total_max_attempts": _TRIES},
            connect_timeout=10,
            read_timeout=90,
            max_pool_connections=AT_ONCE,
            request_checksum_calculation="when_required",  # parts have their SHA-256
            response_checksum_validation="when_required",
        ),
    )


@contextlib.contextmanager
def _translating_errors(url: Url) -> Iterator[None]:
    """Raise botocore's errors as a StoreError of one line, as `as_store_error` does obstore's."""
    try:
        yield
    except ClientError as error:
        code = _code_of(error)
        if code in ("PreconditionFailed", "412"):
            taken = f"{url} exists already: choose another name, or give --force to replace it"
            raise ObjectExistsError(taken) from None
        if code in ("NoSuchUpload", "InvalidPart"):
            spoilt = f"{url}: another process has ended the upload, or sent other parts; give the command again"
            raise _UploadGoneError(spoilt) from None
        raise store_error(url, error, _text(error)) from None
    except (BotoCoreError, ResponseParserError) as error:
        raise store_error(url, error, " ".join(str(error).split())) from None


def _text(error: ClientError) -> str:
    """The error in obstore's form, by which `store_error` recognises it."""
    status = _status_of(error)
    phrase = next((each.phrase for each in http.HTTPStatus if each == status), "Error")
    message = error.response["Error"].get("Message", "")
    elements = f"<Code>{_code_of(error)}</Code><Message>{message}</Message>"
    return f"server returned non-2xx status code: {status} {phrase}: {elements}"


def _code_of(error: ClientError) -> str:
    return str(error.response["Error"].get("Code", ""))


def _status_of(error: ClientError) -> int:
    return int(error.response["ResponseMetadata"]["HTTPStatusCode"])
