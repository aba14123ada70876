"""S3's endpoint and credentials, from the usual environment and ~/.aws, in the form of each of the two clients."""

from __future__ import annotations

import configparser
import contextlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class S3Settings:
    """The settings by which another client than obstore reaches the same store with the same credentials. What is
    None the client finds by itself, such as the machine's role."""

    region: str
    endpoint: str | None
    access_key_id: str | None
    secret_access_key: str | None = field(repr=False)
    session_token: str | None = field(repr=False)
    profile: str | None
    is_unsigned: bool
    is_virtual_hosted: bool  # the bucket is in the host's name, not in the path


def s3_settings() -> S3Settings:
    """The settings by which obstore reaches S3."""
    given, config = os.environ, obstore_s3_config()

    def of(*names: str) -> str | None:
        found = (
            given.get(f"AWS_{name.upper()}") or config.get(name) or config.get(f"aws_{name}") for name in names
        )
        return next(filter(None, found), None)

    return S3Settings(
        region=of("region", "default_region") or "us-east-1",
        endpoint=config.get("endpoint") or given.get("AWS_ENDPOINT"),
        access_key_id=of("access_key_id"),
        secret_access_key=of("secret_access_key"),
        session_token=of("session_token", "token"),
        profile=given.get("AWS_PROFILE"),
        is_unsigned=_is_on("AWS_SKIP_SIGNATURE"),
        is_virtual_hosted=_is_on("AWS_VIRTUAL_HOSTED_STYLE_REQUEST"),
    )


def _is_on(variable: str) -> bool:
    """True for the values that obstore takes for true."""
    return os.environ.get(variable, "").lower() in ("1", "true", "on", "yes", "y")


def obstore_s3_config() -> dict[str, Any]:
    """The settings that obstore does not find by itself: it reads the environment, not ~/.aws."""
    given = os.environ
    # one object at a time is deleted here, and not every store knows how to delete many
    config: dict[str, Any] = {"disable_bulk_delete": True}
    if "AWS_COPY_IF_NOT_EXISTS" not in given:
        config["copy_if_not_exists"] = "multipart"
    profile = _aws_profile()
    if "AWS_ACCESS_KEY_ID" not in given:
        for name in ("aws_access_key_id", "aws_secret_access_key", "aws_session_token"):
            if name in profile:
                config[name] = profile[name]
    if not given.keys() & {"AWS_REGION", "AWS_DEFAULT_REGION"} and "region" in profile:
        config["region"] = profile["region"]
    endpoint = given.get("AWS_ENDPOINT_URL_S3") or given.get("AWS_ENDPOINT_URL") or profile.get("endpoint_url")
    if endpoint:
        config["endpoint"] = endpoint
    return config


def _aws_profile() -> dict[str, str]:
    """The chosen profile of ~/.aws/config and ~/.aws/credentials."""
    name = os.environ.get("AWS_PROFILE", "default")
    home = Path.home() / ".aws"
    files = (
        (os.environ.get("AWS_CONFIG_FILE", home / "config"), name if name == "default" else f"profile {name}"),
        (os.environ.get("AWS_SHARED_CREDENTIALS_FILE", home / "credentials"), name),
    )
    found: dict[str, str] = {}
    for file, section in files:
        parser = configparser.RawConfigParser()
        with contextlib.suppress(OSError, UnicodeDecodeError, configparser.Error):
            parser.read(file, "utf-8")
            if parser.has_section(section):
                found.update(parser.items(section))
    return found
