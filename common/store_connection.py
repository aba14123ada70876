"""Connections to stores, by obstore: whose credentials, which endpoint, how patient.

Credentials and endpoint are those of the usual environment: AWS_ACCESS_KEY_ID and its neighbours or ~/.aws,
AWS_ENDPOINT_URL_S3, GOOGLE_APPLICATION_CREDENTIALS, AZURE_STORAGE_ACCOUNT_NAME and so on. obstore asks again,
later and later, where a store does not answer, answers 5xx, or is cut off.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING, Final

from common.errors import StoreError
from common.location import Url
from common.store_errors import from_url
from common.store_settings import store_settings

if TYPE_CHECKING:
    from obstore.store import ClientConfig, ObjectStore, RetryConfig

_used_by = 0  # the process that first used a store
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


def forget_stores() -> None:
    """Read the environment and the configuration again when a store is next used."""
    _bucket.cache_clear()


def store_of(url: Url, is_patient: bool) -> ObjectStore:
    global _used_by
    if _used_by not in (0, os.getpid()):  # obstore's threads are not in it: it would wait forever
        raise StoreError(
            f"{url}: cannot be read in this process, because its parent had read from a store; start it"
            ' anew (a DataLoader: multiprocessing_context="spawn")'
        )
    _used_by = os.getpid()
    return _bucket(url.scheme, url.bucket, is_patient and not _is_hurried, _HURRIED if _is_hurried else _TIMEOUT)


@cache
def _bucket(scheme: str, bucket: str, is_patient: bool, timeout: timedelta) -> ObjectStore:
    client: ClientConfig = {
        "timeout": timeout,
        "connect_timeout": timedelta(seconds=5),
        "allow_http": True,  # as the endpoint that a person names has it; those of the three are https://
    }
    store: ObjectStore = from_url(
        f"{scheme}://{bucket}",
        config=store_settings(scheme),  # type: ignore[call-overload]  # of the store that the scheme names
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
