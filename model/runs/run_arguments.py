"""Names of new runs, and runs as arguments of the commands that messages suggest."""

from __future__ import annotations

import secrets
import shlex
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Final

from common.errors import did_you_mean, first_of

RUNS: Final = Path("runs")
"""The default folder of runs."""


def new_run_name() -> str:
    """A name for a new run: the date, the time and six random digits, because several trainings may begin in the
    same second."""
    return f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}-{secrets.token_hex(3)}"


def run_argument(run: Path) -> str:
    """A run as an argument of a command, quoted for a shell: the name of a run in `RUNS`, else the path."""
    return shlex.quote(run.name if run.parent == RUNS else str(run))


def suggest_runs(name: str, names: Sequence[str], runs: Path) -> str:
    """A line that suggests runs in `runs` for a mistyped `name`."""
    if not names:
        return f"none is in {runs}: `bc-train` makes one"
    if meant := did_you_mean(name, names):
        return meant
    return f"in {runs} are {first_of(names)}"
