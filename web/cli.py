"""`bc-web`: the workbench in the browser."""

from __future__ import annotations

import contextlib
import socket
import webbrowser
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from common import UserError
from common.command import DONE, INTERRUPTED, check_port, run_command
from common.errors import UsageError, counted, printable
from common.interrupts import stop_signals
from common.location import shown_address
from common.output import print_message, print_result
from common.process_settings import end_with_parent
from recorder.server.connection_guard import is_loopback


@dataclass(frozen=True)
class Web:
    """Serve the workbench for the browser, until Ctrl-C.

    bc-web --open
    """

    port: int = 8080
    """Port of the workbench."""
    host: str = "127.0.0.1"
    """Address to listen on, also for other machines; nothing is encrypted."""
    open: bool = False
    """Open the browser."""
    token: bool = True
    """Ask for no token: every user of this machine can open it."""
    sessions: Path = Path("sessions")
    """The sessions."""
    index: Path = Path("index")
    """The index."""
    runs: Path = Path("runs")
    """The runs."""
    drives: Path = Path("drives")
    """The drives."""


def serve(config: Web, page: str = "") -> int:
    """Serve until a signal. Print the address of `page`, and open it if `config.open`."""
    check_port("--port", config.port)
    if not config.token and not is_loopback(config.host):
        raise UsageError(f"--no-token lets everybody in who reaches --host {config.host}: leave out one of them")
    _check_folders(config)
    from web.app import workbench_app
    from web.folders.cache_folder import default_cache_folder
    from web.folders.project_folders import ProjectFolders
    from web.jobs.jobs import Jobs
    from web.server.request_guard import TOKEN, new_token
    from web.server.workbench_server import WorkbenchServer

    folders = ProjectFolders(config.sessions, config.index, config.runs, config.drives)
    token = new_token() if config.token else ""
    once = new_token() if token and config.open else ""
    cache = default_cache_folder()
    with stop_signals() as stopped, workbench_app(folders, config.host, token, cache, once=once) as app:
        server = WorkbenchServer(app, config.host, config.port)
        server.start()
        address = f"http://{shown_address(config.host, server.port)}/{page}"
        try:
            print_result(f"{address}?{TOKEN}={token}" if token else address)
            print_message("open this address in a browser; Ctrl-C ends it")
            if config.open:
                webbrowser.open(f"{address}?{TOKEN}={once}" if once else address)
            server.serve_until(stopped.wait)
        finally:
            server.stop()
    if running := [job.command for job in Jobs(default_cache_folder()).all() if job.is_running]:
        print_message(f"{counted(len(running), 'job goes', 'jobs go')} on: {'; '.join(running)}")
        print_message(f"to see or stop them, start `bc-web` in {printable(str(Path.cwd()))} and open Jobs")
    return DONE


def _check_folders(config: Web) -> None:
    """Raise UserError for a file instead of a folder. Print which named folders do not exist yet."""
    for name in ("sessions", "index", "runs", "drives"):
        folder: Path = getattr(config, name)
        if folder.exists() and not folder.is_dir():
            raise UserError(f"--{name} {folder}: expected a folder, but it is a file")
        if not folder.exists() and folder != getattr(Web, name):
            print_message(f"--{name} {folder}: no such folder yet; it will be shown when it exists")


def main() -> None:
    run_command("bc-web", Web, serve)


@dataclass(frozen=True)
class WheelPage(Web):
    """Serve the page of a wheel."""

    key: Annotated[str, tyro.conf.Positional] = ""
    """The wheel's key."""


def _show(config: WheelPage) -> int:
    try:
        return serve(replace(config, port=_free_port(config.port)), page=f"wheel/{config.key}")
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


def wheel_main() -> None:
    """The page of one wheel. `common.wheel_page` starts it, and it ends with the process that started it."""
    end_with_parent()
    run_command("bc-web", WheelPage, _show)
