"""The documentation cannot drift: it names every command and flag, and the command lines in it work."""

from __future__ import annotations

import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from driving import COMMANDS, run

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FLAG = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")


@pytest.fixture(scope="module")
def flags() -> dict[str, set[str]]:
    """The flags that the --help of each command shows, and of each of its subcommands (`bc-log info`)."""
    result: dict[str, set[str]] = {}
    with ThreadPoolExecutor(3) as pool:
        for name, shown in zip(COMMANDS, pool.map(help_of, COMMANDS), strict=True):
            result[name] = flags_in(shown)
            subcommands = [f"{name} {sub}" for sub in re.findall(r"• (\w+) ", shown)]
            if name == "bc-train":
                subcommands.append("bc-train export")
            for subcommand, helped in zip(subcommands, pool.map(help_of, subcommands), strict=True):
                result[subcommand] = flags_in(helped)
                result[name] |= result[subcommand]
    return result


def help_of(command: str) -> str:
    name, *subcommand = command.split()
    done = run(name, *subcommand, "--help")
    assert done.returncode == 0, done.stderr
    return done.stdout


def flags_in(shown: str) -> set[str]:
    found = set(re.findall(r"^\W*(?:-\w, )?(--[a-z][a-z0-9-]*)", shown, re.MULTILINE))
    assert found, shown
    return found


def documentation() -> str:
    return "\n".join(page.read_text(encoding="utf-8") for page in PAGES)


def command_lines() -> Iterator[tuple[str, str]]:
    """Page and line of every `bc-` command in a block marked sh."""
    for page in PAGES:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                if (start := line.find("bc-")) >= 0 and not line.lstrip().startswith("#"):
                    yield page.name, line[start:]


def test_the_commands_are_those_of_the_project_file() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    begun_by = {name: f"behavioural_cloning_toolkit:{name.replace('-', '_')}" for name in COMMANDS}
    assert scripts == begun_by


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_flag_is_documented(name: str, flags: dict[str, set[str]]) -> None:
    text = documentation()
    assert all(command in text for command in flags if command.split()[0] == name)
    assert flags[name] - {"--help"} - set(FLAG.findall(text)) == set()


def test_the_command_lines_in_the_documentation_have_flags_that_exist(flags: dict[str, set[str]]) -> None:
    lines = list(command_lines())
    assert lines
    wrong = []
    for page, line in lines:
        words = shlex.split(line, comments=True)
        known = flags.get(" ".join(words[:2]), flags.get(words[0]))
        unknown = {word.split("=")[0] for word in words if word.startswith("--")} - (known or set())
        if known is None or unknown:
            wrong.append(f"{page}: {line}")
    assert wrong == []


def test_the_pictures_and_pages_that_the_documentation_shows_are_there() -> None:
    missing = [
        f"{page.name}: {target}"
        for page in PAGES
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
        if "://" not in target and not (page.parent / target).exists()
    ]
    assert missing == []


def test_no_file_names_a_place_on_one_persons_machine() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False
    )  # fmt: skip
    if listed.returncode != 0:
        pytest.skip("not a git checkout: what belongs to the project is not known")
    place = re.compile(rb"(?<![\w.])/(?:work|root|tmp/w)(?:/|\b)")
    found = []
    for name in listed.stdout.decode().split("\0"):
        path = ROOT / name
        if name and path.is_file() and path != Path(__file__):
            data = path.read_bytes()
            if b"\0" not in data and place.search(data):
                found.append(name)
    assert found == []
