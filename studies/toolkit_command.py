"""The toolkit's commands, as studies run them: in a folder, and without an installation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def command_line(name: str, *words: object) -> list[str]:
    code = f"from behavioural_cloning_toolkit import {name.replace('-', '_')} as main; main()"
    return [sys.executable, "-c", code, *map(str, words)]


def environment() -> dict[str, str]:
    """The environment variables with which `command_line` runs in any folder."""
    return {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}


def output_of(folder: Path, name: str, *words: object) -> str:
    """Print a command, and run it to its end. Returns its output. Raises RuntimeError if it fails."""
    shown = " ".join(map(str, (name, *words)))
    print(shown, file=sys.stderr, flush=True)
    line = command_line(name, *words)
    ended = subprocess.run(line, cwd=folder, env=environment(), stdout=subprocess.PIPE, text=True, check=False)
    if ended.returncode not in (0, 3):
        raise RuntimeError(f"{shown}: exit code {ended.returncode}")
    return ended.stdout
