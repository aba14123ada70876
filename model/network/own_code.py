"""A user's own network: its code runs only if the user names it, never because a run names it.

The file of `FILE.py:CLASS` is read once: the same bytes are run, hashed and kept in the run.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import sha256
from importlib.abc import InspectLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from common.errors import did_you_mean, printable
from common.named_function import in_one_line
from common.untrusted import read_bounded
from model.errors import RunError
from model.network.names import check_network_name, is_file

MAX_SOURCE_BYTES: Final = 1 << 20

_loaded: dict[tuple[str, str], OwnCode] = {}
"""The code that this process has loaded, by the hash of its file (or its module) and its class."""


@dataclass(frozen=True)
class OwnCode:
    """A class or function that makes a network."""

    name: str  # as the user gave it
    make: Callable[..., Any] = field(repr=False)
    source: bytes = field(default=b"", repr=False)  # of the file; empty for a module

    @property
    def label(self) -> str:
        """The name as a run stores it: without the folder of a file."""
        place, _, kind = self.name.rpartition(":")
        return f"{Path(place).name if is_file(self.name) else place}:{kind}"

    @property
    def file_sha256(self) -> str:
        """SHA-256 of the file; empty for a module."""
        return sha256(self.source).hexdigest() if is_file(self.name) else ""


def load_code(name: str) -> OwnCode:
    """Run the file, or import the module, of `name` (`FILE.py:CLASS`, `package.module:CLASS`). After that, this
    process can load runs of that network.

    Raises RunError if the code is missing or fails, or if the class is not in it.
    """
    try:
        check_network_name(name)
    except ValueError as error:
        raise RunError(str(error)) from None
    place, _, kind = name.rpartition(":")
    if is_file(name):
        source = _read(name, Path(place))
        module = _run(name, Path(place), source)
    else:
        source, module = b"", _import(name, place)
    make = getattr(module, kind, None)
    if not callable(make):
        names = [name for name, value in vars(module).items() if isinstance(value, type)]
        meant = did_you_mean(kind, names)
        raise RunError(f"--network {printable(name)}: no {kind} in {place}{f'; {meant}' if meant else ''}")
    code = OwnCode(name, make, source)
    _loaded[code.file_sha256 or place, kind] = code
    return code


def named_code(label: str, file_sha256: str) -> OwnCode | None:
    """The code of a run's network, if this process has loaded it."""
    place, _, kind = label.rpartition(":")
    return _loaded.get((file_sha256 or place, kind))


def named_otherwise(label: str) -> OwnCode | None:
    """The loaded code of another file that has a class of the same name as a run's network."""
    kind = label.rpartition(":")[2]
    return next((code for (_, name), code in _loaded.items() if name == kind and code.source), None)


def _read(name: str, path: Path) -> bytes:
    try:
        return read_bounded(path, MAX_SOURCE_BYTES)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        neighbours = [str(file) for file in path.parent.glob("*.py")]
        meant = did_you_mean(str(path), neighbours) or "give FILE.py:CLASS, the file by its path from this folder"
        raise RunError(
            f"--network {printable(name)}: {printable(str(path))} cannot be read ({why}); {meant}"
        ) from None


class _Source(InspectLoader):
    """Loads a module from source that is already read, and caches no bytecode next to the file."""

    def __init__(self, path: Path, source: bytes) -> None:
        self._path = path
        self._source = source

    def get_source(self, fullname: str) -> str:
        return importlib.util.decode_source(self._source)

    def get_code(self, fullname: str) -> Any:
        return self.source_to_code(self._source, str(self._path))


def _run(name: str, path: Path, source: bytes) -> ModuleType:
    spec = spec_from_loader(f"network_{sha256(source).hexdigest()[:16]}", _Source(path, source), origin=str(path))
    assert spec is not None  # noqa: S101
    assert spec.loader is not None  # noqa: S101
    module = module_from_spec(spec)
    module.__file__ = str(path)
    sys.modules[spec.name] = module  # dataclasses look up their module in it
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[spec.name]
        raise RunError(f"--network {printable(name)}: {path} cannot be run ({in_one_line(error)})") from None
    return module


def _import(name: str, place: str) -> ModuleType:
    try:
        return importlib.import_module(place)
    except (Exception, SystemExit) as error:
        raise RunError(f"--network {printable(name)}: {place} cannot be imported ({in_one_line(error)})") from None
