"""Connections to stores with obstore: credentials, endpoint, timeouts and retries.

Credentials and endpoint come from the usual environment variables and files: AWS_ACCESS_KEY_ID or ~/.aws,
AWS_ENDPOINT_URL_S3, GOOGLE_APPLICATION_CREDENTIALS, AZURE_STORAGE_ACCOUNT_NAME and so on. obstore repeats a
request, with growing pauses, if the store does not answer, answers 5xx, or the connection is cut.
"""

from __future__ import annotations

import os
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING, Final

from common.errors import StoreError
from common.location import Url
from common.store_errors import from_url
from common.store_settings import store_settings

if TYPE_CHECKING:
    from obstore.store import ClientConfig, ObjectStore, RetryConfig

_used_by = 0  # ID of the process that first used a store

# The first request of a process to a bucket fails within seconds. Later requests, for example of a long training,
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


def forget_stores() -> None:
    """Read the environment and the configuration again at the next request."""
    _bucket.cache_clear()


def store_of(url: Url, is_patient: bool) -> ObjectStore:
    """The store of a URL. `is_patient`: repeat requests for 90 s, else for 10 s. Raises StoreError in a forked
    process whose parent has used a store."""
    global _used_by
    if _used_by not in (0, os.getpid()):  # a forked process lacks obstore's threads, and would wait forever
        raise StoreError(
            f"{url}: cannot be read in a forked process whose parent has read from a store; spawn the process"
            ' (a DataLoader: multiprocessing_context="spawn")'
        )
    _used_by = os.getpid()
    return _bucket(url.scheme, url.bucket, is_patient)


@cache
def _bucket(scheme: str, bucket: str, is_patient: bool) -> ObjectStore:
    client: ClientConfig = {
        "timeout": timedelta(minutes=5),  # for a request and all bytes of its answer
        "connect_timeout": timedelta(seconds=5),
        "allow_http": True,  # for an endpoint that the user names; the default endpoints are https://
    }
    store: ObjectStore = from_url(
        f"{scheme}://{bucket}",
        config=store_settings(scheme),  # type: ignore[call-overload]  # the scheme decides the type
        client_options=client,
        retry_config=_PATIENT if is_patient else _IMPATIENT,
    )
    return store
