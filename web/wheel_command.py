"""The page of one wheel. `common.wheel_page` starts it, and it ends with the process that started it."""

from __future__ import annotations

import contextlib
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common import UserError
from common.command import INTERRUPTED, run_command
from common.process_settings import end_with_parent
from web.cli import Web, serve


@dataclass(frozen=True)
class WheelPage:
    """Serve the page of a wheel."""

    key: Annotated[str, tyro.conf.Positional]
    """The wheel's key."""
    open: bool = False
    """Open the page in a browser."""
    sessions: Path = Web.sessions
    """Where sessions are kept."""
    runs: Path = Web.runs
    """Where runs are kept."""
    drives: Path = Web.drives
    """Where drives are kept."""


def _show(config: WheelPage) -> int:
    try:
        web = Web(
            port=_free_port(Web.port),
            open=config.open,
            sessions=config.sessions,
            runs=config.runs,
            drives=config.drives,
        )
        return serve(web, page=f"wheel/{config.key}")
    except KeyboardInterrupt:  # ended by the command that drives
        return INTERRUPTED
    except UserError as error:
        raise UserError(f"{error}; start `bc-web` in this folder, and open its page Drive") from None


def _free_port(preferred: int) -> int:
    """The preferred port, or another one if that is taken."""
    for port in (preferred, 0):
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)) as probe:
            return int(probe.getsockname()[1])
    return preferred


def main() -> None:
    end_with_parent()
    run_command("bc-web", WheelPage, _show)
