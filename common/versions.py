"""The version of this toolkit, and those of installed packages."""

from __future__ import annotations

import shlex
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

TOOLKIT: Final = "behavioural-cloning-toolkit"
VERSION: Final = "0.2.0"
"""Of the toolkit: the only place where it stands. pyproject.toml and all commands take it from here."""


def install_line(extra: str) -> str:
    """The command that installs an extra: from the toolkit's folder, as the toolkit is on no package index."""
    folder = Path(__file__).parent.parent
    is_checkout = (folder / "pyproject.toml").is_file()
    return f"pip install -e {shlex.quote(f'{folder}[{extra}]')}" if is_checkout else f"pip install '.[{extra}]'"


def version_of(package: str = TOOLKIT) -> str:
    """The version of this toolkit, or of an installed package; "unknown" where that is not installed."""
    if package == TOOLKIT:
        return VERSION
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
