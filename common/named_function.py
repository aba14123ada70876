"""Load a function of the user's own code by name. Only the named file or module is run."""

from __future__ import annotations

import importlib
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from common.errors import UsageError, UserError, did_you_mean, printable
from common.versions import package_line


def load_function(flag: str, name: str) -> Callable[..., Any]:
    """The function `module:function` or `FILE.py:function`; modules may also be in the working folder.

    Raises UsageError for another form, UserError if the function does not exist or its code cannot be imported.
    """
    place, _, function = name.rpartition(":")
    if not place or not function.isidentifier():
        raise UsageError(f"{flag} {name}: expected module:function or FILE.py:function")
    names = (
        _names_of_file(flag, name, Path(place)) if place.endswith(".py") else _names_of_module(flag, name, place)
    )
    loaded: Callable[..., Any] | None = names.get(function)
    if not callable(loaded):
        functions = [other for other, value in names.items() if callable(value) and not other.startswith("_")]
        meant = did_you_mean(function, functions)
        raise UserError(f"{flag} {name}: no function {function} in {place}{f'; {meant}' if meant else ''}")
    return loaded


def in_one_line(error: BaseException) -> str:
    """The type and the first line of an error of the user's code, for a message."""
    first, *_ = [*str(error).strip().splitlines(), ""]
    return printable(f"{type(error).__name__}: {first}" if first else type(error).__name__)[:300]


def _names_of_file(flag: str, name: str, path: Path) -> dict[str, Any]:
    if not path.is_file():
        meant = did_you_mean(str(path), [str(path.with_name(other.name)) for other in path.parent.glob("*.py")])
        raise UserError(f"{flag} {name}: no file {path}; {meant or f'give its path from {Path.cwd()}'}")
    try:
        return runpy.run_path(str(path))
    except ModuleNotFoundError as error:
        raise _missing(f"{flag} {name}: {path}", error) from None
    except (Exception, SystemExit) as error:
        raise UserError(f"{flag} {name}: {path} cannot be run ({in_one_line(error)})") from None


def _names_of_module(flag: str, name: str, place: str) -> dict[str, Any]:
    if (folder := str(Path.cwd())) not in sys.path:
        sys.path.append(folder)  # last, so that it hides no other module
    try:
        return vars(importlib.import_module(place))
    except ModuleNotFoundError as error:
        if error.name is not None and place.startswith(error.name):  # the module itself
            raise UserError(f"{flag} {name}: {place} cannot be imported ({in_one_line(error)})") from None
        raise _missing(f"{flag} {name}: {place}", error) from None
    except (Exception, SystemExit) as error:
        raise UserError(f"{flag} {name}: {place} cannot be imported ({in_one_line(error)})") from None


def _missing(where: str, error: ModuleNotFoundError) -> UserError:
    """The error of code that imports a module that is not installed. Most packages have the name of their
    module."""
    module = printable((error.name or "").partition(".")[0])
    return UserError(f"{where} needs the module {module}, which is not installed: `{package_line(module)}`")
