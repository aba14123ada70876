"""Writes the lists of flags in docs/commands.md from each command's own `--help-all` (`make docs`)."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

from generated_blocks import ROOT, update, with_blocks

PAGE: Final = ROOT / "docs" / "commands.md"
COLUMNS: Final = 129
"""From 130 on, boxes stand next to each other."""
_REPEATED: Final = re.compile(r"\[?(\S+) \[\1 \.\.\.\]\]?")  # `[{a,b} [{a,b} ...]]`
_DEFAULT: Final = re.compile(r" ?\((required|default: ([^()]*))\)$")

_VERBS: Final = (  # not shown by tyro
    *("bc-record me", "bc-record listen", "bc-record gym"),
    *("bc-train resume", "bc-train continue", "bc-train export"),
    *("bc-eval drive", "bc-eval compare"),
    "bc-index export",
)


@dataclass(frozen=True)
class Argument:
    """A flag or a positional argument of a command, as `--help-all` shows it."""

    invocation: str
    """`--rate FLOAT`, `--force`, `NAME`"""
    meaning: str
    default: str
    """empty where there is none worth a word"""


def main() -> None:
    update(PAGE, generated_page())


def generated_page(shown: dict[str, str] | None = None) -> str:
    """docs/commands.md as it should be, of what `commands` has found."""
    lists: dict[str, list[str]] = {}
    for name, text in (shown or commands()).items():
        lists[name] = _without_repeated(_list(text), lists)
    blocks = {name: "\n".join(lines) + "\n" for name, lines in lists.items()}
    return with_blocks(PAGE.read_text(encoding="utf-8"), blocks)


def commands(help_of: Callable[[str], str] | None = None) -> dict[str, str]:
    """The `--help-all` of each command with arguments of its own: "bc-index", "bc-log check", "bc-train export".

    `help_of` returns the text for such a name, at `COLUMNS`."""
    help_of = help_of or _help
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        shown = dict(zip(scripts, pool.map(help_of, scripts), strict=True))
        subcommands = [f"{name} {sub}" for name, text in shown.items() for sub in re.findall(r"• (\w+) ", text)]
        with_subcommands = {name.split()[0] for name in subcommands}
        subcommands += _VERBS
        texts = zip(subcommands, pool.map(help_of, subcommands), strict=True)
        return {name: text for name, text in shown.items() if name not in with_subcommands} | dict(texts)


def arguments(help_text: str) -> list[Argument]:
    """The arguments in the boxes of a command's `--help-all`."""
    arguments: list[tuple[str, str]] = []
    for line in re.findall(r"^│ (.*?) *│$", help_text, re.MULTILINE):
        if line.startswith(" "):  # goes on with the argument above
            invocation, meaning = arguments.pop()
            arguments.append((invocation, f"{meaning} {line.strip()}".strip()))
        elif line.startswith("-") or "  " in line:
            invocation, _, meaning = line.partition("  ")
            arguments.append((invocation, meaning.strip()))
    return [_argument(*pair) for pair in arguments if pair[0] != "-h, --help"]


def _argument(invocation: str, meaning: str) -> Argument:
    default = ""
    if match := _DEFAULT.search(meaning):
        meaning, default = meaning[: match.start()], match[2] or ""
    if default in {"None", "none", "not", "True", "False", "''"}:  # an option that is off
        default = ""
    return Argument(_REPEATED.sub(r"\1 ...", invocation), meaning, default)


def _list(help_text: str) -> list[str]:
    lines = []
    for argument in arguments(help_text):
        default = f" (`{argument.default}`)" if argument.default else ""
        lines.append(f"- `{argument.invocation}`{default}: {argument.meaning}")
    return lines


def _without_repeated(lines: list[str], described: dict[str, list[str]]) -> list[str]:
    """The lines of a command. Three or more that an earlier command has, too, become one that names them."""
    for name, known in described.items():
        repeated = [line for line in lines if line in known]
        if len(repeated) >= 3:
            flags = ", ".join(f"`{line.split('`')[1]}`" for line in repeated)
            named = f"- As in [{name}](#{name.replace(' ', '-')}): {flags}."
            return [line for line in lines if line not in repeated] + [named]
    return lines


def _help(command: str) -> str:
    name, *subcommand = command.split()
    code = f"from behavioural_cloning_toolkit import {name.replace('-', '_')} as main; main()"
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "COLUMNS": str(COLUMNS),
        "NO_COLOR": "1",
        "OMP_NUM_THREADS": "1",
    }
    line = [sys.executable, "-c", code, *subcommand, "--help-all"]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
    return done.stdout


if __name__ == "__main__":
    main()
