"""The place of a file: a path of this machine, or the URL of an object in a store (s3://, gs://, az://).

`pathlib` would make "s3:/bucket" of "s3://bucket": what a person gives is read once, by `location`, and is from
then on either a `Path` or a `Url`, which has those of a path's methods that need no file.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, TypeAlias
from urllib.parse import unquote, urlsplit

from common.errors import UsageError, UserError
from common.untrusted import real_path

SCHEMES: Final = ("s3", "gs", "az")
"""Of Amazon's S3 and all that speak its protocol, Google Cloud Storage, Azure Blob Storage."""

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

    def is_in(self, folder: Url) -> bool:
        """True for what is in a folder, or in one within that."""
        is_there = (self.scheme, self.bucket) == (folder.scheme, folder.bucket)
        return is_there and self.key.startswith(f"{folder.key}/" if folder.key else "")

    def name_in(self, folder: Url) -> str:
        """The name, with slashes, of what `is_in` a folder."""
        return self.key.removeprefix(f"{folder.key}/")

    def joined(self, relative: str) -> Url:
        """The place that a path relative to this folder leads to. Raises ValueError for one that leads out of the
        bucket."""
        parts = self.key.split("/") if self.key else []
        for part in relative.split("/"):
            if part == "..":
                if not parts:
                    raise ValueError(f"{relative} leads out of {self}")
                parts.pop()
            elif part not in ("", "."):
                parts.append(part)
        return Url(self.scheme, self.bucket, "/".join(parts))


Location: TypeAlias = Path | Url


def location(text: str | Location) -> Location:
    """The place that a person names. Raises UsageError for a URL of another kind, or of no bucket."""
    if not isinstance(text, str):
        return text
    match = _URL.fullmatch(text)
    if match is None:
        if _COLLAPSED.match(text):
            raise UsageError(f"{text}: no path; a URL is spelt {_with_all_slashes(text)}")
        return Path(text)
    scheme, rest = match[1].lower(), match[2]
    if scheme == "file":
        return Path(unquote(urlsplit(text).path))
    if scheme not in SCHEMES:
        kinds = ", ".join(f"{known}://" for known in SCHEMES)
        raise UsageError(f"{text}: not a path, nor a URL that begins with {kinds} or file://")
    bucket, _, key = rest.partition("/")
    if not bucket:
        raise UsageError(f"{text}: no bucket in it; {scheme}://BUCKET/NAME is expected")
    return Url(scheme, bucket, "/".join(filter(None, key.split("/"))))


def is_in_store(text: str) -> bool:
    """True if what a person gives is the URL of an object, or folder, in a store."""
    match = _URL.fullmatch(text)
    return match is not None and match[1].lower() in SCHEMES


def absolute(place: Location) -> Location:
    """The same place, independent of the current folder."""
    return place if isinstance(place, Url) else real_path(place)


def local_path(place: Location) -> Path:
    """The place if it is on this machine. Raises UserError for one in a store."""
    if isinstance(place, Url):
        raise UserError(f"{place} must be on this machine: run `bc-log copy {place} FOLDER`")
    return place


def refuse_collapsed(path: Path) -> None:
    """Raise UsageError for a path that was made of a URL: only a file of this machine can be used here."""
    if _COLLAPSED.match(text := os.fspath(path)):
        refuse_urls([_with_all_slashes(text)])


def _with_all_slashes(text: str) -> str:
    return text.replace(":/", ":///" if text.startswith("file:") else "://", 1)


def refuse_urls(words: Sequence[str]) -> None:
    """Raise UsageError for a URL among the words of a command that takes none."""
    for word in words:
        if (match := _URL.fullmatch(word)) and match[1].lower() in (*SCHEMES, "file"):
            raise UsageError(
                f"{word}: a place of this machine is expected here, no URL; `bc-log copy {word} FOLDER` brings a"
                " log here, `bc-log copy LOG URL` takes one there; `bc-train --copy-to URL` does so with a run,"
                " which URL/NAME then names"
            )


def relative_to(place: Location, folder: Location) -> str:
    """The name of a file in another one that lies in `folder`: both can be moved together. Where only one of them
    is in a store, or they are in different buckets, it is named by its URL."""
    if isinstance(place, Url):
        if not isinstance(folder, Url) or (place.scheme, place.bucket) != (folder.scheme, folder.bucket):
            return str(place)
        return posixpath.relpath(f"/{place.key}", f"/{folder.key}")
    if isinstance(folder, Url):
        return real_path(place).as_uri()
    return Path(os.path.relpath(real_path(place), real_path(folder))).as_posix()
