"""Exports: a network or a recording in another program's format, made by a job, then downloaded."""

from __future__ import annotations

import secrets
import shutil
import zipfile
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Final
from urllib.parse import quote

from common import atomic_file
from common.versions import install_line
from web.errors import or_404

_KEPT: Final = 8  # exports, the newest
_ONNX: Final = ("onnx", "onnxruntime", "onnxscript")


@dataclass(frozen=True)
class ExportKind:
    """A command that writes a file or folder of another format."""

    name: str
    title: str
    command: tuple[str, ...]  # before the network or recording
    flag: str  # before the written file or folder
    ending: str  # of its name; a folder is downloaded as a zip
    needs: tuple[str, ...] = ()  # packages of an extra of the same name as the first

    @property
    def missing(self) -> str:
        """The command that installs what it needs; "" if that is here."""
        return install_line(self.needs[0]) if any(find_spec(package) is None for package in self.needs) else ""


RUN_EXPORTS: Final = (
    ExportKind("onnx", "ONNX file", ("bc-train", "export"), "--onnx", ".onnx", _ONNX),
    ExportKind("donkeycar", "DonkeyCar part", ("bc-train", "export"), "--donkeycar", "-donkeycar", _ONNX),
    ExportKind("hub", "Hugging Face folder", ("bc-train", "export"), "--hub", "-hub", _ONNX),
)
LOG_EXPORTS: Final = (
    ExportKind("lerobot", "LeRobot dataset", ("bc-log", "export"), "--lerobot", "-lerobot"),
    ExportKind("udacity", "Udacity folder", ("bc-log", "export"), "--udacity", "-udacity"),
    ExportKind("video", "Video", ("bc-play",), "--video", ".mp4"),
)


class Exports:
    """What was exported, in the cache: each file or folder in a folder of its own."""

    def __init__(self, cache: Path) -> None:
        self._folder = cache / "exports"

    def words(self, export: ExportKind, source: Path, name: str) -> tuple[list[str], str]:
        """The words of the command, and the address of what it makes. The oldest exports are deleted."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for old in sorted(self._folder.iterdir())[: -(_KEPT - 1)]:
            shutil.rmtree(old, ignore_errors=True)
        folder = self._folder / f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{secrets.token_hex(4)}"
        folder.mkdir()
        made = folder / f"{name}{export.ending}"
        return [*export.command, str(source), export.flag, str(made)], f"/exports/{folder.name}/{quote(made.name)}"

    def file(self, key: str, name: str) -> Path:
        """The exported file, or the zip of the exported folder. Raises WebError if it is no longer kept."""
        folders = {path.name: path for path in self._folder.iterdir()} if self._folder.is_dir() else {}
        folder = or_404(folders.get(key), "this export is no longer kept: export it again")
        made = or_404(
            next((path for path in folder.iterdir() if path.name == name), None),
            "nothing was exported: the page of its activity says why",
        )
        return zipped(made) if made.is_dir() else made


def zipped(folder: Path) -> Path:
    """A zip next to the folder, of the folder. It is not compressed: pictures and videos are already."""
    path = folder.with_name(f"{folder.name}.zip")
    if not path.exists():
        with atomic_file(path, overwrite=True) as part, zipfile.ZipFile(part, "w") as archive:
            for file in sorted(folder.rglob("*")):
                archive.write(file, Path(folder.name) / file.relative_to(folder))
    return path
