"""`bc-doctor`: summarise a project: its folders, odd rows, the newest run, and the next commands."""

from __future__ import annotations

import contextlib
import json
import shlex
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.command import DONE, run_command, warn
from common.errors import UserError
from common.output import print_result


@dataclass(frozen=True)
class Doctor:
    """Summarise a project: its folders, odd rows, the newest network, and the next three commands. Exit code 3 if
    something cannot be read.

    bc-doctor
    bc-doctor ~/driving
    """

    project: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="[PATH]")] = Path()
    """Folder of the project."""
    json: bool = False
    """Print one JSON object."""


def doctor(config: Doctor) -> int:
    if not config.project.is_dir():
        problem = "a file, not a folder" if config.project.exists() else "no such folder"
        raise UserError(f"{config.project}: {problem}; give the folder of a project, which has sessions/ or runs/")
    from drive.doctor import examine  # NumPy, Arrow

    with contextlib.chdir(config.project):  # the printed commands are for this folder
        diagnosis = examine()
    if config.json:
        print_result(json.dumps(asdict(diagnosis)))
    else:
        print_result(*diagnosis.here)
        print_result(*(f"odd: {line}" for line in diagnosis.odd))
        print_result(*(f"how good: {line}" for line in diagnosis.good))
        cd = f"cd {shlex.quote(str(config.project))} && " if config.project != Path() else ""
        print_result(*(f"next: `{cd}{advice.command}`: {advice.why}" for advice in diagnosis.advice))
    return max([DONE, *map(warn, diagnosis.problems)])


def main() -> None:
    run_command("bc-doctor", Doctor, doctor)
