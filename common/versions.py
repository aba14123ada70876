"""Versions of installed packages."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

TOOLKIT = "behavioural-cloning-toolkit"


def version_of(package: str = TOOLKIT) -> str:
    """The version of an installed package; "unknown" where it is not installed, as our own may be."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
