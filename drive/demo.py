"""`bc-demo`: the whole chain on the built-in simulator, with the commands that a user would type."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from common import UserError
from common.command import DONE, run_command


@dataclass(frozen=True)
class Demo:
    """Record half a lap of each track, index, train, and drive a full lap of both.

    Every command is printed before it runs. Takes some minutes on two cores.
    """

    folder: Path | None = None
    """A new folder to work in; by default demo/DATE."""
    epochs: int = 4
    """Epochs of training; more drive better."""
    laps: float = 1.0
    """How far the trained network drives on each track."""
    share: float = 0.5
    """How much of each track's lap is recorded."""


def demo(config: Demo) -> int:
    folder = config.folder or Path("demo") / f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}"
    if folder.exists():
        raise UserError(f"{folder}: exists already; give another --folder")
    folder.mkdir(parents=True)
    start_s = time.monotonic()
    print(f"working in {folder}", flush=True)
    for command in (
        f"bc-record lake --track lake --laps {config.share:g}",
        f"bc-record mountain --track mountain --laps {config.share:g}",
        "bc-index",
        f"bc-train --name demo --epochs {config.epochs}",
        f"bc-eval demo --simulator lake mountain --laps {config.laps:g}",
        "bc-play drives/demo-mountain-10mph.mcap --save drives/demo-mountain-10mph.rrd",
    ):
        _run(command, folder)
    minutes = (time.monotonic() - start_s) / 60
    print(
        f"\nDone in {minutes:.1f} minutes. Watch the drive:\n"
        f"    cd {shlex.quote(str(folder))}\n"
        "    bc-play drives/demo-mountain-10mph.mcap"
    )
    return DONE


def _run(command: str, folder: Path) -> None:
    print(f"\n$ {command}", flush=True)
    program, *arguments = shlex.split(command)
    # beside this Python first: the virtual environment need not be active
    found = shutil.which(program, path=sysconfig.get_path("scripts")) or shutil.which(program)
    if found is None:
        raise UserError(
            f"{program}: not installed beside {sys.executable}; install the toolkit with `pip install .`"
        )
    code = subprocess.run([found, *arguments], cwd=folder, check=False).returncode
    if code != 0:
        raise UserError(f"`{command}` ended with exit code {code}; what it wrote is in {folder}")


def main() -> None:
    run_command("bc-demo", Demo, demo)
