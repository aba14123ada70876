"""Recordings that a browser uploads to the project, each a folder in `recordings/`, whole or not at all.

A body begins with a manifest in JSON: the paths and sizes of its files. The files follow, one after the other. A
single zip is unpacked; several ones each to a folder of its name. Everything is untrusted: names are checked
before a file is made.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Final

import msgspec

from common.errors import counted, printable
from common.files import PART_SUFFIX, make_folder, part_path, remove_empty
from common.untrusted import json_as
from recorder.new_session import plain_name
from web.errors import WebError

MAX_UPLOAD_BYTES: Final = 64 << 30  # sent, and again unpacked
MAX_FILES: Final = 300_000
_MAX_MANIFEST_BYTES: Final = 64 << 20
_MAX_DIRECTORY_BYTES: Final = 64 << 20  # of a zip, which is read into memory
_MAX_NAME_BYTES: Final = 240
_SPARE_BYTES: Final = 64 << 20  # of the disk
_BLOCK_BYTES: Final = 1 << 20
_ZIP: Final = ".upload.zip"
_UNWANTED: Final = frozenset({"__MACOSX", ".DS_Store", "Thumbs.db", _ZIP})


class Manifest(msgspec.Struct):
    """The files of an upload, in their order."""

    files: list[tuple[str, int]]  # path with slashes, bytes


class Upload:
    """An upload that is being received: `write` its bytes, then `finish` it. Otherwise nothing is kept."""

    def __init__(self, folder: Path, manifest_bytes: int, total_bytes: int) -> None:
        """`folder` has all uploads. Raises WebError for a manifest of an invalid length. The server has checked
        `total_bytes`."""
        if not 0 < manifest_bytes <= min(_MAX_MANIFEST_BYTES, total_bytes):
            raise WebError(f"manifest={manifest_bytes}: expected the bytes of the upload's manifest", 422)
        self._parent = folder
        self._above: list[Path] = []
        self._name = "recording"
        self._part = part_path(folder / self._name)
        self._manifest = bytearray()
        self._left = manifest_bytes  # bytes of the manifest or file that is being received
        self._total_bytes = total_bytes - manifest_bytes
        self._files: list[tuple[Path | None, int]] | None = None  # to come; None: left out
        self._stream: IO[bytes] | None = None
        self._zips: list[tuple[Path, Path]] = []  # and the folders for their files

    def __enter__(self) -> Upload:
        self._above = make_folder(self._parent)
        try:
            refuse_full(self._parent, self._total_bytes)
            self._part.mkdir()
        except BaseException:
            remove_empty(self._above)
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._close()
        shutil.rmtree(self._part, ignore_errors=True)  # renamed already if it was finished
        remove_empty(self._above)

    def write(self, data: bytes) -> None:
        """Take the next bytes. Raises WebError for invalid names or sizes."""
        view = memoryview(data)
        while view:
            if not self._left:
                raise WebError("the upload has more bytes than its manifest says", 422)
            block, view = view[: self._left], view[self._left :]
            self._left -= len(block)
            if self._files is None:
                self._manifest += block
                if not self._left:
                    self._begin_files()
            else:
                if self._stream is not None:
                    self._stream.write(block)
                self._next_file()

    def finish(self) -> Path:
        """Give the upload its name, and return its folder. Raises WebError if it is incomplete."""
        if self._files is None or self._files or self._left:
            raise WebError("the upload is incomplete: it was cut off", 422)
        self._close()
        for archive, folder in self._zips:
            folder.mkdir(exist_ok=True)
            unpack(archive, folder)
            archive.unlink()
        if not any(self._part.iterdir()):
            raise WebError("the upload has no file", 422)
        return self._named()

    def _begin_files(self) -> None:
        manifest = json_as(bytes(self._manifest), Manifest)
        self._manifest.clear()
        if manifest is None or not 0 < len(manifest.files) <= MAX_FILES:
            raise WebError(f"expected an upload of 1 to {MAX_FILES:,} files", 422)
        sizes = [size for _, size in manifest.files]
        if min(sizes) < 0 or sum(sizes) != self._total_bytes:
            raise WebError("the upload's files have other sizes than its manifest says", 422)
        places = [checked_name(name) for name, _ in manifest.files]
        top = list(dict.fromkeys(place[0] for place in places if place))
        has_top = len(top) == 1 and all(len(place) > 1 for place in places if place)
        if top:
            self._name = plain_name(top[0]) + (f"-and-{len(top) - 1}-more" if len(top) > 1 else "")
        files = [place[has_top:] for place in places]
        self._files = [
            (self._part.joinpath(*parts) if parts else None, size)
            for parts, size in zip(reversed(files), reversed(sizes), strict=True)
        ]
        for number, parts in enumerate(files):
            if len(parts) == 1 and parts[0].lower().endswith(".zip") and (len(files) == 1 or not has_top):
                folder = self._part if len(files) == 1 else self._part / plain_name(parts[0])
                self._zips.append((self._part / f"{number}{_ZIP}", folder))
                self._files[-1 - number] = self._zips[-1][0], sizes[number]
        self._next_file()

    def _next_file(self) -> None:
        """Open the next file, if the current one is complete."""
        while not self._left and self._files:
            self._close()
            path, self._left = self._files.pop()
            if path is not None:
                self._stream = _new_file(path)

    def _close(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _named(self) -> Path:
        names = itertools.chain([self._name], (f"{self._name}-{number}" for number in itertools.count(2)))
        folders = (self._parent / name for name in names)
        return self._part.rename(next(folder for folder in folders if not os.path.lexists(folder)))


def uploads_in(folder: Path) -> dict[str, Path]:
    """The uploads in a folder by their names. Links, and folders whose name cannot be shown, are left out."""
    folders = [path for path in sorted(folder.glob("*")) if path.is_dir() and not path.is_symlink()]
    return {path.name: path for path in folders if path.suffix != PART_SUFFIX and path.name.isprintable()}


def remove_upload(upload: Path) -> None:
    """Delete an upload, and the folder of all of them if it was the last one."""
    shutil.rmtree(upload)
    remove_empty([upload.parent])


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a zip into a folder. Raises WebError if it is damaged, too large, or has paths outside the folder."""
    try:
        with archive.open("rb") as stream:
            if _directory_bytes(stream) > _MAX_DIRECTORY_BYTES:
                raise WebError("the zip has a directory that is too large", 413)
        with zipfile.ZipFile(archive) as opened:
            _unpack(opened, folder)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError) as error:
        raise WebError(f"the zip cannot be unpacked ({printable(str(error))[:200]})", 422) from None


def _unpack(archive: zipfile.ZipFile, folder: Path) -> None:
    members = archive.infolist()
    if len(members) > MAX_FILES:
        raise WebError(f"the zip has {counted(len(members), 'file')}: at most {MAX_FILES:,} are allowed", 413)
    left = MAX_UPLOAD_BYTES
    refuse_full(folder, sum(member.file_size for member in members))
    for member in members:
        parts = checked_name(member.filename.rstrip("/"))
        if not parts or member.is_dir():
            continue
        if (member.external_attr >> 28) == 0xA:  # a link, as Unix writes it
            raise WebError(f"{printable(member.filename)}: links are not unpacked; zip the files themselves", 422)
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise WebError("the zip has a password or an unusual compression: unpack it, and drop the folder", 422)
        with archive.open(member) as source, _new_file(folder.joinpath(*parts)) as target:
            while block := source.read(_BLOCK_BYTES):
                left -= len(block)
                if left < 0:
                    raise WebError(f"the zip unpacks to more than {MAX_UPLOAD_BYTES:,} bytes", 413)
                target.write(block)


def _directory_bytes(stream: IO[bytes]) -> int:
    """The length of a zip's directory by the records at the zip's end: the largest, if there are several."""
    stream.seek(-min(stream.seek(0, 2), (1 << 16) + 200), 2)
    end = stream.read()
    short = [end[at.start() + 12 : at.start() + 16] for at in re.finditer(b"PK\5\6", end)]
    long = [end[at.start() + 40 : at.start() + 48] for at in re.finditer(b"PK\6\6", end)]
    sizes = [int.from_bytes(size, "little") for size in [*short, *long]]
    return max((size for size in sizes if size != 0xFFFFFFFF), default=0)  # means: see the 64-bit record


def checked_name(name: str) -> Sequence[str]:
    """The parts of a file's path in an upload; none for files that operating systems add. Raises WebError for a
    path that leads outside, or a name that is not valid on every system."""
    parts = name.split("/")
    for part in parts:
        is_plain = part not in ("", ".", "..") and part.isprintable() and not set(part) & set('\\:*?"<>|')
        if not is_plain or len(part.encode()) > _MAX_NAME_BYTES:
            raise WebError(f"{printable(name)[:200]}: this file name is not valid on every system; rename it", 422)
    return () if _UNWANTED & set(parts) else parts


def refuse_full(folder: Path, size: int) -> None:
    """Raise WebError if the disk has no room for `size` bytes."""
    free = shutil.disk_usage(folder).free - _SPARE_BYTES
    if size > free:
        raise WebError(f"{folder}: {size / 1e6:,.0f} MB, but the disk has room for {max(0, free) / 1e6:,.0f}", 507)


def _new_file(path: Path) -> IO[bytes]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("xb")
    except (FileExistsError, NotADirectoryError, IsADirectoryError):
        raise WebError(f"{printable(path.name)}: in the upload twice", 422) from None
