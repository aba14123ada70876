"""Convert obstore's errors, which have several lines, to one line with the next step.

obstore is an optional package. Only this module imports it; without it, the error names the command to install it.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from typing import Final

from common.errors import NoSuchObjectError, ObjectExistsError, StoreError, UserError
from common.location import Url
from common.versions import install_line

try:
    import obstore as obstore
    from obstore import exceptions as exceptions
    from obstore.store import from_url as from_url
except ImportError:
    raise UserError(f"reading from a store needs obstore: run `{install_line('scale')}`") from None

# Texts of errors that mean: the user gave no credentials, and the machine has no role.
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
_ENDPOINTS: Final = {
    "s3": ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL"),
    "gs": ("GOOGLE_BASE_URL",),
    "az": ("AZURE_STORAGE_ENDPOINT",),
}
_NOT_VALID: Final = ("InvalidAccessKeyId", "SignatureDoesNotMatch", "ExpiredToken", "InvalidToken")
_RIGHTS: Final = {
    "s3": "the rights s3:GetObject and s3:ListBucket (without the latter, S3 also refuses missing objects); to"
    " write, also s3:PutObject and s3:DeleteObject",
    "gs": "the role Storage Object User",
    "az": "the role Storage Blob Data Contributor",
}


@contextlib.contextmanager
def as_store_error(url: Url) -> Iterator[None]:
    """Raise obstore's errors, which have several lines, as a StoreError of one line."""
    try:
        yield
    except (exceptions.BaseError, FileNotFoundError) as error:  # FileNotFoundError: the object does not exist
        raise store_error(url, error, " ".join(str(error).split())) from None


def is_out_of_range(text: str) -> bool:
    return "416 Range Not Satisfiable" in text or "InvalidRange" in text


def is_cut_off(text: str) -> bool:
    return "response body" in text or "invalid list response" in text or "invalid multipart response" in text


def is_no_bucket(text: str) -> bool:
    return "NoSuchBucket" in text or "ContainerNotFound" in text or "specified bucket does not exist" in text


def is_refused(text: str) -> bool:
    return re.search(r"status code: (40[013]|501) ", text) is not None


def store_error(url: Url, error: Exception, text: str) -> StoreError:
    """The one-line error for an error of obstore; `text` is its message."""
    bucket = f"{url.scheme}://{url.bucket}"
    if isinstance(error, exceptions.AlreadyExistsError):
        return ObjectExistsError(f"{url} exists already: choose another name, or give --force to replace it")
    if is_no_bucket(text):
        return NoSuchObjectError(f"{bucket}: no such bucket{_endpoint(url)}; give the name of an existing one")
    if "NoSuchUpload" in text:
        return StoreError(f"{url}: the store has given the upload up{_endpoint(url)}; give the command again")
    if isinstance(error, FileNotFoundError):
        return NoSuchObjectError(f"{url}: no such object; `bc-log ls {url.parent}` lists those that exist")
    if _NO_CREDENTIALS.search(text):
        return StoreError(f"{bucket}: no usable credentials: set {_CREDENTIALS[url.scheme]}")
    if "redirect" in text.lower() or "AuthorizationHeaderMalformed" in text or "IncorrectEndpoint" in text:
        return StoreError(f"{bucket}: is in another region: set AWS_REGION (or AWS_ENDPOINT_URL_S3)")
    if "RequestTimeTooSkewed" in text:
        return StoreError(f"{bucket}: refused, because this machine's clock is wrong; set the clock")
    if (code := _code(text).strip(" ()")) in _NOT_VALID:
        return StoreError(f"{bucket}: the credentials are not valid ({code}): set {_CREDENTIALS[url.scheme]}")
    is_forbidden = isinstance(error, exceptions.PermissionDeniedError | exceptions.UnauthenticatedError)
    if is_forbidden or "403 Forbidden" in text:  # for a refused listing, obstore raises GenericError
        rights = f"; they need {_RIGHTS[url.scheme]}" if _code(text) in _NO_RIGHT else ""
        return StoreError(f"{url}: the store refuses this request with these credentials{_code(text)}{rights}")
    if isinstance(error, exceptions.NotSupportedError) or "NotImplemented" in text:
        return StoreError(f"{url}: the store does not support this request{_code(text)}")
    return StoreError(f"{url}: {_reason(text)}{_endpoint(url)}")


def _code(text: str) -> str:
    code = re.search(r"<Code>(\w+)</Code>", text)
    return f" ({code[1]})" if code else ""


def _endpoint(url: Url) -> str:
    endpoint = next(filter(None, map(os.environ.get, _ENDPOINTS[url.scheme])), None)
    return f" (endpoint {endpoint})" if endpoint else ""


def _reason(text: str) -> str:
    status = re.search(r"[Ss]erver returned non-2xx status code: (\d+ [A-Z][\w ]*?):", text)
    if status:
        message = re.search(r"<Message>(.+?)</Message>", text)
        return f"the store answers {status[1]}{_code(text)}" + (f": {message[1][:200]}" if message else "")
    unreachable = ("refused", "error trying to connect", "dns", "could not connect", "connect timeout")
    if "onnect" in text and any(words in text.lower() for words in unreachable):
        return "the store cannot be reached"
    if is_cut_off(text) or "Connection was closed" in text:
        return "the connection to the store was cut, again and again; give the command again"
    plain = text.partition(" Debug source:")[0]
    return f"the store does not answer as it should: {plain[:300]}"
