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
    names = _names_in(place, f"{flag} {name}: ")
    loaded: Callable[..., Any] | None = names.get(function)
    if not callable(loaded):
        functions = [other for other, value in names.items() if callable(value) and not other.startswith("_")]
        meant = did_you_mean(function, functions, "; ")
        raise UserError(f"{flag} {name}: no function {function} in {place}{meant}")
    return loaded


def in_one_line(error: BaseException) -> str:
    """The type and the first line of an error of the user's code, for a message."""
    first, *_ = [*str(error).strip().splitlines(), ""]
    return printable(f"{type(error).__name__}: {first}" if first else type(error).__name__)[:300]


def _names_in(place: str, flag: str) -> dict[str, Any]:
    """The names that a file or module defines. `flag`: the beginning of errors."""
    path = Path(place)
    is_file = path.suffix == ".py"
    if is_file and not path.is_file():
        meant = did_you_mean(str(path), [str(path.with_name(other.name)) for other in path.parent.glob("*.py")])
        raise UserError(f"{flag}no file {path}; {meant or f'give its path from {Path.cwd()}'}")
    if not is_file and (folder := str(Path.cwd())) not in sys.path:
        sys.path.append(folder)  # last, so that it hides no other module
    try:
        return runpy.run_path(str(path)) if is_file else vars(importlib.import_module(place))
    except (Exception, SystemExit) as error:
        why = f"cannot be {'run' if is_file else 'imported'} ({in_one_line(error)})"
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing and (is_file or not place.startswith(missing)):  # a module that the code imports
            module = printable(missing.partition(".")[0])  # most packages have the name of their module
            why = f"needs the module {module}, which is not installed: `{package_line(module)}`"
        raise UserError(f"{flag}{path if is_file else place} {why}") from None
