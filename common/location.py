"""The place of a file: a path on this machine, or the URL of an object in a store (s3://, gs://, az://).

`pathlib` would turn "s3://bucket" into "s3:/bucket". So `location` converts the user's text once, to a `Path` or a
`Url`. A `Url` has the methods of `Path` that do not access files.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, TypeAlias
from urllib.parse import urlsplit

from common.errors import UsageError, UserError
from common.untrusted import real_path

SCHEMES: Final = ("s3", "gs", "az")
"""Amazon S3 and compatible stores, Google Cloud Storage, Azure Blob Storage."""

_URL: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://(.*)", re.DOTALL)
_COLLAPSED: Final = re.compile(rf"(?:{'|'.join(SCHEMES)}|file):/(?!/)")


@dataclass(frozen=True, order=True)
class Url:
    """An object in a store, or a folder of objects; written as scheme://bucket/key."""

    scheme: str
    bucket: str
    key: str = ""  # without a slash at either end

    def __str__(self) -> str:
        return f"{self.scheme}://{self.bucket}/{self.key}"

    def __truediv__(self, name: str) -> Url:
        return Url(self.scheme, self.bucket, f"{self.key}/{name}" if self.key else name)

    @property
    def name(self) -> str:
        return self.key.rpartition("/")[2]

    @property
    def suffix(self) -> str:
        return PurePosixPath(self.name).suffix

    @property
    def stem(self) -> str:
        return PurePosixPath(self.name).stem

    @property
    def parent(self) -> Url:
        return Url(self.scheme, self.bucket, self.key.rpartition("/")[0])

    def with_name(self, name: str) -> Url:
        return self.parent / name

    def name_in(self, folder: Url) -> str:
        """The path relative to `folder`, which contains this place."""
        return self.key.removeprefix(f"{folder.key}/")


Location: TypeAlias = Path | Url


def location(text: str | Location) -> Location:
    """Parse a path or URL. Raises UsageError for a URL with another scheme, or without a bucket."""
    if not isinstance(text, str):
        return text
    match = _URL.fullmatch(text)
    if match is None:
        if _COLLAPSED.match(text):
            raise UsageError(f"{text}: not a path; the URL is spelt {_with_all_slashes(text)}")
        return Path(text)
    scheme, rest = match[1].lower(), match[2]
    if scheme == "file":
        from urllib.request import url2pathname  # slow to import: it imports email and sockets

        return Path(url2pathname(urlsplit(text).path))
    if scheme not in SCHEMES:
        kinds = ", ".join(f"{name}://" for name in SCHEMES)
        raise UsageError(f"{text}: not a path, nor a URL that begins with {kinds} or file://")
    bucket, _, key = rest.partition("/")
    if not bucket:
        raise UsageError(f"{text}: the bucket is missing; expected {scheme}://BUCKET/NAME")
    return Url(scheme, bucket, "/".join(filter(None, key.split("/"))))


def absolute(place: Location) -> Location:
    """The same place, independent of the working folder."""
    return place if isinstance(place, Url) else real_path(place)


def local_path(place: str | Location) -> Path:
    """The place as a path of this machine. Raises UserError for a place in a store."""
    path = location(place)
    if isinstance(path, Url):
        raise UserError(f"{path} is in a store; bring it here first: `bc-copy {path} FOLDER`")
    return path


def _with_all_slashes(text: str) -> str:
    return text.replace(":/", ":///" if text.startswith("file:") else "://", 1)


def relative_to(place: Location, folder: Path) -> str:
    """The relative path by which a file in `folder` refers to `place`, so that both can be moved together; the URL
    of a place in a store."""
    if isinstance(place, Url):
        return str(place)
    return Path(os.path.relpath(real_path(place), real_path(folder))).as_posix()


def shown_address(host: str, port: int) -> str:
    """Host and port as in a URL: an IPv6 address has brackets."""
    host = host.strip("[]")
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
