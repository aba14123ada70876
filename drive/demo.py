"""`bc-demo`: runs the commands of the whole chain on the built-in simulator, as a user would type them."""

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
from common.command import DONE, DONE_BUT_SKIPPED, run_command
from common.errors import UsageError
from common.output import print_message, print_result, shell_command
from common.progress import duration_text
from common.streams import drain


@dataclass(frozen=True)
class Demo:
    """Record half a lap of each track, index, train, and drive a full lap of both.

    Every command is printed before it runs. Takes about 5 minutes on two idle cores, and 0.9 GB of disk.
    """

    folder: Path | None = None
    """A folder to work in, new or without a project's folders; by default demo/DATE."""
    epochs: int = 4
    """Epochs of training; more drive better."""
    laps: float = 1.0
    """How far the trained network drives on each track."""
    share: float = 0.5
    """How much of each track's lap is recorded."""


_MADE: Final = ("sessions", "index", "runs", "drives")
"""The folders that its commands make."""


@dataclass(frozen=True)
class DemoStep:
    command: str
    seconds: float
    """Measured on two cores; on another machine, all steps are slower or faster alike."""


def steps_of(config: Demo) -> list[DemoStep]:
    """The steps of the demo, in their order."""
    share = config.share
    return [
        DemoStep(f"bc-record lake --track lake --laps {share:g}", 3 + 60 * share),
        DemoStep(f"bc-record mountain --track mountain --laps {share:g}", 3 + 66 * share),
        DemoStep("bc-index", 3),
        DemoStep(f"bc-train --name demo --epochs {config.epochs}", 10 + 48 * share * config.epochs),
        DemoStep(f"bc-eval demo --simulator lake mountain --laps {config.laps:g}", 10 + 85 * config.laps),
        DemoStep("bc-play drives/demo-mountain-10mph.mcap --save drives/demo-mountain-10mph.rrd", 6),
    ]


def demo(config: Demo) -> int:
    folder = config.folder or Path("demo") / f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}"
    _refuse_unusable_settings(config, folder)
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    steps = steps_of(config)
    seconds = sum(step.seconds for step in steps)
    print_result(f"working in {folder}; all takes about {duration_text(seconds)} on two idle cores")
    if (activate := _activation_command()) is not None:
        print_result(f"to type these commands yourself, there: {activate}")
    start_s, code = time.monotonic(), DONE
    for number, step in enumerate(steps):
        done = sum(each.seconds for each in steps[:number])
        elapsed_s = time.monotonic() - start_s
        left = f", about {duration_text((seconds - done) * elapsed_s / done)} left" if number else ""
        print_result("", f"{number + 1} of {len(steps)}{left}", f"$ {step.command}")
        try:
            code = max(code, _run(step.command, folder))
        except KeyboardInterrupt:
            if any((folder / name).exists() for name in _MADE):
                there = f"`cd {shlex.quote(str(folder))}`"
                print_message(f"bc-demo: what was made is in {folder}; type its commands there: {there}")
            elif is_new:
                folder.rmdir()
            raise
    log = folder / "drives" / "demo-mountain-10mph.mcap"
    print_result(
        "",
        f"Done in {duration_text(time.monotonic() - start_s)}. Watch the drive:",
        f"    {shell_command('bc-play')} {shlex.quote(str(log))}",
        "Now drive yourself: this opens the browser; choose Drive there:",
        f"    {shell_command('bc-web')} --open",
    )
    return code


def _refuse_unusable_settings(config: Demo, folder: Path) -> None:
    """Raise UserError, or UsageError, now for settings that a later step would refuse, after minutes."""
    if there := [name for name in _MADE if (folder / name).exists()]:
        raise UserError(f"{folder}: has {', '.join(there)} already; give another --folder")
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: a file, no folder to work in; give another --folder")
    if not 1 <= config.epochs <= 10**6:
        raise UsageError(f"--epochs {config.epochs}: a number from 1 to 1,000,000 was expected")
    if not 0 < config.laps <= 1000:
        raise UsageError(f"--laps {config.laps:g}: a number above 0, and up to 1,000, was expected")
    if not 0.05 <= config.share <= 1000:
        raise UsageError(
            f"--share {config.share:g}: a number of laps from 0.05 on was expected: less trains nothing"
        )
    for step in steps_of(config):
        _program(step.command.split()[0])


def _activation_command() -> str | None:
    """The line after which a shell finds the commands; None if it does already."""
    if shell_command("bc-play") == "bc-play":
        return None
    activate = Path(sysconfig.get_path("scripts")) / "activate"
    return f"source {shlex.quote(str(activate))}" if activate.exists() else None


def _program(name: str) -> str:
    # beside this Python first: its virtual environment need not be active
    found = shutil.which(name, path=sysconfig.get_path("scripts")) or shutil.which(name)
    if found is None:
        raise UserError(f"{name}: not installed beside {sys.executable}; install the toolkit with `pip install .`")
    return found


def _run(command: str, folder: Path) -> int:
    """Run a command to its end; its exit code. Raises UserError if it has failed."""
    name, *arguments = shlex.split(command)
    drain()  # it prints by itself
    process = subprocess.Popen([_program(name), *arguments], cwd=folder)
    try:
        code = process.wait()
    except KeyboardInterrupt:  # Ctrl-C reaches it too; `kill` does not
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        process.wait()
        raise
    if code not in (DONE, DONE_BUT_SKIPPED):
        raise UserError(f"`{command}` ended with exit code {code}; what it wrote is in {folder}")
    return code


def main() -> None:
    run_command("bc-demo", Demo, demo)
