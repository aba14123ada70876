"""The versions of the toolkit and of installed packages, and the commands that install more packages."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

TOOLKIT: Final = "behavioural-cloning-toolkit"
VERSION: Final = "0.4.0"
"""The version of the toolkit. pyproject.toml and all commands read this constant."""


def install_line(extra: str) -> str:
    """The command that adds an extra to this environment. It installs the toolkit again from its folder or URL,
    because the toolkit is on no package index."""
    checkout = Path(__file__).parent.parent
    if (checkout / "pyproject.toml").is_file():
        return _install(["-e", f"{_short(checkout)}[{extra}]"], checkout)
    from urllib.request import url2pathname  # slow to import: it imports email and sockets

    url = _origin()
    folder = Path(url2pathname(urlsplit(url).path)) if url.startswith("file:") else None
    if folder is not None and (folder / "pyproject.toml").is_file():
        return _install([f"{_short(folder)}[{extra}]"], folder)
    return _install([f"{TOOLKIT}[{extra}] @ {url}" if url and folder is None else f".[{extra}]"], None)


def package_line(package: str) -> str:
    """The command that adds another package to this environment."""
    checkout = Path(__file__).parent.parent
    return _install([package], checkout if (checkout / "pyproject.toml").is_file() else None)


def _install(packages: list[str], checkout: Path | None) -> str:
    """The install command of the tool that made this environment: uv, pipx or pip. With a checkout, it installs
    the tested versions."""
    prefix = Path(sys.prefix)
    if _is_made_by_uv(prefix):
        installer = ["uv", "pip", "install", "--python", str(prefix)]
    elif (prefix / "pipx_metadata.json").is_file():
        installer = ["pipx", "runpip", TOOLKIT, "install"]
    else:
        installer = ["pip", "install"]
    tested = checkout / "constraints.txt" if checkout is not None else None
    constraints = ["-c", _short(tested)] if tested is not None and tested.is_file() else []
    return shlex.join([*installer, *constraints, *packages])


def _is_made_by_uv(prefix: Path) -> bool:
    try:
        return any(line.startswith("uv =") for line in (prefix / "pyvenv.cfg").read_text().splitlines())
    except (OSError, ValueError):
        return False


def _short(path: Path) -> str:
    """The path relative to the working folder, if the folder contains it; else the path."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def _origin() -> str:
    """The URL of the folder or repository from which pip installed the toolkit (PEP 610); "" if pip has none."""
    from importlib.metadata import PackageNotFoundError, distribution  # email, too

    try:
        direct_url = json.loads(distribution(TOOLKIT).read_text("direct_url.json") or "{}")
        vcs = direct_url.get("vcs_info", {}).get("vcs")
        return f"{vcs}+{direct_url['url']}" if vcs else str(direct_url.get("url", ""))
    except (PackageNotFoundError, ValueError, AttributeError):
        return ""


def version_of(package: str = TOOLKIT) -> str:
    """The version of the toolkit, or of an installed package; "unknown" if the package is not installed."""
    if package == TOOLKIT:
        return VERSION
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
