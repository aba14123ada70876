"""The check of the settings of a store in the environment and ~/.aws, before obstore uses them.

An endpoint that is no URL, or a region or a key with odd characters, lets obstore panic: a hundred lines.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Final
from urllib.parse import urlsplit

from common.errors import StoreError, printable

_ENDPOINTS: Final = {
    "s3": ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"),
    "gs": ("GOOGLE_BASE_URL",),
    "az": ("AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT", "AZURITE_BLOB_STORAGE_URL"),
}
_REGIONS: Final = {"s3": ("AWS_REGION", "AWS_DEFAULT_REGION")}
_KEYS: Final = {"s3": ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")}
_REGION: Final = re.compile(r"[A-Za-z0-9-]+")


def check_environment(scheme: str, config: Mapping[str, object]) -> None:
    """Raise StoreError for a setting that no store of this scheme can be reached with. `config` is what was read
    from ~/.aws."""
    for name, value in _given(scheme, _ENDPOINTS, config, "endpoint"):
        _check_endpoint(name, value)
    for name, value in _given(scheme, _REGIONS, config, "region"):
        if not _REGION.fullmatch(value):
            raise StoreError(f"{name}={printable(value[:100])}: a region was expected, such as us-east-1")
    for name, value in _given(scheme, _KEYS, {}, ""):
        if not value.isprintable():
            raise StoreError(f"{name}: contains a line end or another invisible character; remove it")


def _given(
    scheme: str, names: Mapping[str, tuple[str, ...]], config: Mapping[str, object], setting: str
) -> list[tuple[str, str]]:
    """The names and values of the settings that are there."""
    settings = [(name, value) for name in names.get(scheme, ()) if (value := os.environ.get(name))]
    stored = config.get(setting)
    if isinstance(stored, str) and stored not in dict(settings).values():
        settings.append((f"~/.aws/config: {setting}", stored))
    return settings


def _check_endpoint(name: str, value: str) -> None:
    try:
        url = urlsplit(value)
        host, port = url.hostname, url.port
    except ValueError:  # a port that is none, or an address in brackets
        host, port = None, None
    is_plain = value.isascii() and value.isprintable() and " " not in value
    if not (is_plain and host and port != 0 and value.startswith(("http://", "https://"))):
        raise StoreError(
            f"{name}={printable(value[:100])}: no endpoint; http://HOST:PORT or https://HOST:PORT was expected"
        )
