"""The settings of stores from the environment and ~/.aws. obstore itself reads only the environment.

The settings are checked first: if an endpoint is not a URL, or a region or key has odd characters, obstore panics
and prints a hundred lines.
"""

from __future__ import annotations

import configparser
import contextlib
import os
import re
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from common.errors import StoreError, printable

_ENDPOINTS: Final = {
    "s3": ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"),
    "gs": ("GOOGLE_BASE_URL",),
    "az": ("AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT", "AZURITE_BLOB_STORAGE_URL"),
}
_S3_REGIONS: Final = ("AWS_REGION", "AWS_DEFAULT_REGION")
_S3_KEYS: Final = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
_REGION: Final = re.compile(r"[A-Za-z0-9-]+")


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
