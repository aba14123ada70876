"""Runs the examples of the documentation with the toolkit as it is installed, in an empty folder.

    python docs/run_examples.py FOLDER

All lines of the README's loop but bc-web, then the Python of README.md and docs/. Trainings and drives are
shortened; what would open a viewer is written to a file. The release workflow runs this outside the repository,
from the wheel.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
PAGES: Final = ("README.md", "docs/commands.md", "docs/index-format.md", "docs/log-format.md")
SHORTER: Final = {
    "--name first ": "--name first --epochs 1 ",
    "seed=1": "epochs=1",
    "--simulator lake": "--laps 0.1 --simulator lake",
    "--tracks lake": "--laps 0.1 --tracks lake",
}


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir()
    for number, words in enumerate(_commands(), 1):
        if words[0] == "bc-web":
            continue  # until somebody ends it
        if words[0] == "bc-play" and "--video" not in words:
            words += ["--save", f"{number}.rrd"]
        _run([str(Path(sys.executable).parent / words[0]), *words[1:]], folder)
    shutil.copy(folder / "drives" / "run.mcap", folder)  # the drive that the pages read
    for page in PAGES:
        for code in blocks((ROOT / page).read_text(encoding="utf-8"), "python"):
            _run([sys.executable, "-I", "-c", code], folder)
    for example in sorted((ROOT / "examples").glob("log_*.py")):
        _run([sys.executable, "-I", str(example)], folder)


def _commands() -> Iterator[list[str]]:
    """The command lines of the README's section "The loop"."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    section = readme.partition("## The loop\n")[2].partition("\n## ")[0]
    for block in blocks(section, "sh"):
        for line in block.splitlines():
            if words := shlex.split(line, comments=True):
                yield words


def blocks(text: str, language: str) -> Iterator[str]:
    for block in re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL):
        for long, short in SHORTER.items():
            block = block.replace(long, short)
        yield block


def _run(line: list[str], folder: Path) -> None:
    print("$", shlex.join(line), flush=True)
    done = subprocess.run(line, cwd=folder, check=False)
    if done.returncode != 0:
        sys.exit(f"exit code {done.returncode}")


if __name__ == "__main__":
    main()
