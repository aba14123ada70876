"""S3's endpoint and credentials in ~/.aws, for obstore, which reads the environment alone."""

from __future__ import annotations

import configparser
import contextlib
import os
from pathlib import Path
from typing import Any


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
