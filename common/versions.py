"""The version of this toolkit, those of installed packages, and the commands that install more."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

TOOLKIT: Final = "behavioural-cloning-toolkit"
VERSION: Final = "0.3.0"
"""Of the toolkit: the only place where it stands. pyproject.toml and all commands take it from here."""


def install_line(extra: str) -> str:
    """The command that adds an extra to this environment. The toolkit is on no package index: it comes again from
    the folder or URL that it was installed from."""
    checkout = Path(__file__).parent.parent
    if (checkout / "pyproject.toml").is_file():
        return _install(["-e", f"{_short(checkout)}[{extra}]"], checkout)
    from urllib.request import url2pathname  # email and sockets

    url = _origin()
    folder = Path(url2pathname(urlsplit(url).path)) if url.startswith("file:") else None
    if folder is not None and (folder / "pyproject.toml").is_file():
        return _install([f"{_short(folder)}[{extra}]"], folder)
    return _install([f"{TOOLKIT}[{extra}] @ {url}" if url and folder is None else f".[{extra}]"], None)


def package_line(package: str) -> str:
    """The command that adds another's package to this environment."""
    checkout = Path(__file__).parent.parent
    return _install([package], checkout if (checkout / "pyproject.toml").is_file() else None)


def _install(what: list[str], checkout: Path | None) -> str:
    """By what has made this environment: uv, pipx or pip; with the versions that a checkout was tested with."""
    prefix = Path(sys.prefix)
    if _is_of_uv(prefix):
        installer = ["uv", "pip", "install", "--python", str(prefix)]
    elif (prefix / "pipx_metadata.json").is_file():
        installer = ["pipx", "runpip", TOOLKIT, "install"]
    else:
        installer = ["pip", "install"]
    tested = checkout / "constraints.txt" if checkout is not None else None
    constraints = ["-c", _short(tested)] if tested is not None and tested.is_file() else []
    return shlex.join([*installer, *constraints, *what])


def _is_of_uv(prefix: Path) -> bool:
    try:
        return any(line.startswith("uv =") for line in (prefix / "pyvenv.cfg").read_text().splitlines())
    except (OSError, ValueError):
        return False


def _short(path: Path) -> str:
    """A path from here, where that is below here."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def _origin() -> str:
    """The URL that pip has noted of the toolkit's folder or repository; "" without one."""
    from importlib.metadata import PackageNotFoundError, distribution  # email, too

    try:
        noted = json.loads(distribution(TOOLKIT).read_text("direct_url.json") or "{}")
        vcs = noted.get("vcs_info", {}).get("vcs")
        return f"{vcs}+{noted['url']}" if vcs else str(noted.get("url", ""))
    except (PackageNotFoundError, ValueError, AttributeError):
        return ""


def version_of(package: str = TOOLKIT) -> str:
    """The version of this toolkit, or of an installed package; "unknown" where that is not installed."""
    if package == TOOLKIT:
        return VERSION
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
