"""Connections to stores with obstore: credentials, endpoint, timeouts and retries.

Credentials and endpoint come from the usual environment variables and files: AWS_ACCESS_KEY_ID or ~/.aws,
AWS_ENDPOINT_URL_S3, GOOGLE_APPLICATION_CREDENTIALS, AZURE_STORAGE_ACCOUNT_NAME and so on. obstore itself reads
only the environment. The settings are checked first: if an endpoint is not a URL, or a region or key has odd
characters, obstore panics and prints a hundred lines.

obstore repeats a request, with growing pauses, if the store does not answer, answers 5xx, or the connection is
cut.
"""

from __future__ import annotations

import configparser
import contextlib
import os
import re
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from common.errors import StoreError, printable
from common.location import Url
from common.store_errors import from_url

if TYPE_CHECKING:
    from obstore.store import ClientConfig, ObjectStore, RetryConfig

_ENDPOINTS: Final = {
    "s3": ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"),
    "gs": ("GOOGLE_BASE_URL",),
    "az": ("AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT", "AZURITE_BLOB_STORAGE_URL"),
}
_S3_REGIONS: Final = ("AWS_REGION", "AWS_DEFAULT_REGION")
_S3_KEYS: Final = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
_REGION: Final = re.compile(r"[A-Za-z0-9-]+")

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


def store_settings(scheme: str) -> dict[str, Any]:
    """The settings that obstore does not read by itself. Raises StoreError for an invalid setting."""
    config = _s3_settings() if scheme == "s3" else {}
    for name, value in _values_of(_ENDPOINTS[scheme], config, "endpoint"):
        _check_endpoint(name, value)
    if scheme == "s3":
        for name, value in _values_of(_S3_REGIONS, config, "region"):
            if not _REGION.fullmatch(value):
                raise StoreError(f"{name}={printable(value[:100])}: expected a region, such as us-east-1")
        for name in _S3_KEYS:
            if not os.environ.get(name, "").isprintable():
                raise StoreError(f"{name}: contains a line end or another invisible character; remove it")
    return config


def _s3_settings() -> dict[str, Any]:
    environment = os.environ
    # the toolkit deletes one object at a time, and not every store supports bulk deletion
    config: dict[str, Any] = {"disable_bulk_delete": True}
    profile = _aws_profile()
    if "AWS_ACCESS_KEY_ID" not in environment:
        config |= {name: profile[name] for name in map(str.lower, _S3_KEYS) if name in profile}
    if not environment.keys() & set(_S3_REGIONS) and "region" in profile:
        config["region"] = profile["region"]
    endpoints = (environment.get("AWS_ENDPOINT_URL_S3"), environment.get("AWS_ENDPOINT_URL"))
    if endpoint := next(filter(None, (*endpoints, profile.get("endpoint_url"))), None):
        config["endpoint"] = endpoint
    return config


def _aws_profile() -> dict[str, str]:
    """The settings of the profile AWS_PROFILE in ~/.aws/config and ~/.aws/credentials."""
    name = os.environ.get("AWS_PROFILE", "default")
    home = Path(os.path.expanduser("~/.aws"))  # noqa: PTH111 - Path.home raises without a home
    files = (
        (os.environ.get("AWS_CONFIG_FILE", home / "config"), name if name == "default" else f"profile {name}"),
        (os.environ.get("AWS_SHARED_CREDENTIALS_FILE", home / "credentials"), name),
    )
    profile: dict[str, str] = {}
    for file, section in files:
        parser = configparser.RawConfigParser()
        with contextlib.suppress(OSError, UnicodeDecodeError, configparser.Error):
            parser.read(file, "utf-8")
            if parser.has_section(section):
                profile.update(parser.items(section))
    return profile


def _values_of(names: tuple[str, ...], config: dict[str, Any], setting: str) -> list[tuple[str, str]]:
    """The values of a setting in the environment and in ~/.aws, as pairs (name, value)."""
    settings = [(name, value) for name in names if (value := os.environ.get(name))]
    stored = config.get(setting)
    if stored and stored not in dict(settings).values():
        settings.append((f"~/.aws/config: {setting}", stored))
    return settings


def _check_endpoint(name: str, value: str) -> None:
    try:
        url = urlsplit(value)
        host, port = url.hostname, url.port
    except ValueError:  # an invalid port, or an invalid address in brackets
        host, port = None, None
    is_plain = value.isascii() and value.isprintable() and " " not in value
    if not (is_plain and host and port != 0 and value.startswith(("http://", "https://"))):
        raise StoreError(
            f"{name}={printable(value[:100])}: not an endpoint; expected http://HOST:PORT or https://HOST:PORT"
        )
