"""`bc-demo`: run the commands of the whole chain on the built-in simulator, as a user would type them."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from common import UserError
from common.command import DONE, DONE_BUT_SKIPPED, flags_given, run_command
from common.errors import UsageError
from common.output import print_message, print_result, shell_command
from common.progress import duration_text

SPEED_MPH: Final = 15
"""Of the network's drives. It learnt at 10 mph, and needs no help at 15 either, in two thirds of the time."""


@dataclass(frozen=True)
class Demo:
    """Record half a lap of each track, index, train, and drive a full lap of both.

    2 to 6 minutes on two cores; 0.9 GB of disk.
    """

    folder: Path | None = None
    """Folder to work in, which must not hold a project; by default demo/DATE."""
    quick: bool = False
    """Only a seventh of a lap and a small network: two minutes."""
    epochs: int = 0
    """Epochs of training; 0: as many as `bc-train` chooses."""
    laps: float = 1.0
    """Laps that the network drives on each track."""
    share: float = 0.5
    """Share of each track's lap that is recorded."""


_MADE: Final = ("sessions", "index", "runs", "drives")  # the folders that the demo's commands make


def commands_of(config: Demo) -> list[str]:
    tracks: tuple[str, ...] = ("lake", "mountain")
    share, laps = config.share, config.laps
    network = ""
    if config.quick:
        tracks, share, laps = ("lake",), 0.15, 0.15
        network = " --network small"
    drive = f"drives/demo-{tracks[-1]}-{SPEED_MPH}mph"
    return [
        *(f"bc-record {track} --track {track} --laps {share:g}" for track in tracks),
        "bc-index",
        f"bc-train --name demo{network}{f' --epochs {config.epochs}' if config.epochs else ''}",
        f"bc-eval drive demo --tracks {' '.join(tracks)} --laps {laps:g} --speed {SPEED_MPH}",
        f"bc-play {drive}.mcap --save {drive}.rrd",
    ]


def demo(config: Demo) -> int:
    folder = config.folder or Path("demo") / f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}"
    _refuse_unusable_settings(config, folder)
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    commands = commands_of(config)
    print_result(f"working in {folder}")
    if (activate := _activation_command()) is not None:
        print_result(f"to type these commands yourself in that folder: {activate}")
    start_s, code = time.monotonic(), DONE
    for number, command in enumerate(commands, start=1):
        begin_s = time.monotonic()
        print_result("", f"{number} of {len(commands)}", f"$ {command}")
        try:
            code = max(code, _run(command, folder))
        except KeyboardInterrupt:
            if any((folder / name).exists() for name in _MADE):
                cd = f"`cd {shlex.quote(str(folder))}`"
                print_message(f"bc-demo: the results are in {folder}; to continue, first type {cd}")
            elif is_new:
                folder.rmdir()
            raise
        print_result(f"took {duration_text(time.monotonic() - begin_s)}")
    log = folder / shlex.split(commands[-1])[1]
    print_result(
        "",
        f"Done in {duration_text(time.monotonic() - start_s)}. Watch the drive:",
        f"    {shell_command('bc-play')} {shlex.quote(str(log))}",
        "Now drive yourself: this opens the browser; choose Drive there:",
        f"    {shell_command('bc-web')} --open",
    )
    return code


def _refuse_unusable_settings(config: Demo, folder: Path) -> None:
    """Raise UserError or UsageError for settings that a later step would refuse after minutes."""
    if config.quick and (flags := flags_given(config, "epochs", "laps", "share")):
        raise UsageError(f"{flags}: --quick sets these itself: give one or the other")
    if existing := [name for name in _MADE if (folder / name).exists()]:
        raise UserError(f"{folder}: has {', '.join(existing)} already; give another --folder")
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: a file, no folder to work in; give another --folder")
    if not 0 <= config.epochs <= 10**6:
        raise UsageError(f"--epochs {config.epochs}: expected a number from 0 to 1,000,000")
    if not 0 < config.laps <= 1000:
        raise UsageError(f"--laps {config.laps:g}: expected a number above 0 and up to 1,000")
    if not 0.05 <= config.share <= 1000:
        raise UsageError(f"--share {config.share:g}: give at least 0.05 laps: less is not enough to train on")
    for command in commands_of(config):
        _program(command.split()[0])


def _activation_command() -> str | None:
    """The line that makes the shell find the commands; None if it finds them already."""
    if shell_command("bc-play") == "bc-play":
        return None
    activate = Path(sysconfig.get_path("scripts")) / "activate"
    return f"source {shlex.quote(str(activate))}" if activate.exists() else None


def _program(name: str) -> str:
    # first next to this Python: its virtual environment need not be active
    program = shutil.which(name, path=sysconfig.get_path("scripts")) or shutil.which(name)
    if program is None:
        raise UserError(f"{name}: not next to {sys.executable}; install the toolkit again")
    return program


def _run(command: str, folder: Path) -> int:
    name, *arguments = shlex.split(command)
    process = subprocess.Popen([_program(name), *arguments], cwd=folder)
    try:
        code = process.wait()
    except KeyboardInterrupt:  # Ctrl-C reaches the command, too; `kill` does not
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        process.wait()
        raise
    if code not in (DONE, DONE_BUT_SKIPPED):
        raise UserError(f"`{command}` ended with exit code {code}; what it wrote is in {folder}")
    return code


def main() -> None:
    run_command("bc-demo", Demo, demo)
