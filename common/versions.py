"""The version of this toolkit, and those of installed packages."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Final

TOOLKIT: Final = "behavioural-cloning-toolkit"
VERSION: Final = "0.2.0"
"""Of the toolkit: the only place where it stands. pyproject.toml and all commands take it from here."""


def version_of(package: str = TOOLKIT) -> str:
    """The version of this toolkit, or of an installed package; "unknown" where that is not installed."""
    if package == TOOLKIT:
        return VERSION
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
