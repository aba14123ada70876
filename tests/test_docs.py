"""The documentation cannot drift: it names every command and flag, and the command lines in it work."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image, ImageSequence

import make_architecture
import make_commands
from tests.helpers.driving import COMMANDS, command, environment
from tests.helpers.repository import ROOT

PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")), ROOT / "benchmarks" / "README.md"]
SOURCES = [path for room in make_architecture.ROOMS for path in make_architecture.modules(room)]
WRITTEN_BY_COMMANDS = ("sessions/", "index/", "runs/", "drives/", "IMG/")


@pytest.fixture(scope="module")
def helps() -> dict[str, str]:
    """The --help-all of each command."""

    def help_of(name: str) -> str:
        command_name, *subcommand = name.split()
        line = command(command_name, *subcommand, "--help-all")  # in a process: tyro keeps what it has parsed
        columns = {"COLUMNS": str(make_commands.COLUMNS)}
        done = subprocess.run(line, env=environment() | columns, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return make_commands.commands(help_of)


@pytest.fixture(scope="module")
def flags(helps: dict[str, str]) -> dict[str, set[str]]:
    """The flags that the --help-all of each command shows, and of each of its subcommands (`bc-log info`)."""
    result: dict[str, set[str]] = {name: set() for name in COMMANDS}
    for name, shown in helps.items():
        invocations = [argument.invocation.split()[0] for argument in make_commands.arguments(shown)]
        assert invocations, shown
        result[name] = {word for word in invocations if word.startswith("--")}
        result[name.split()[0]] |= result[name]
    return result


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


def test_what_is_generated_is_current(helps: dict[str, str]) -> None:
    """If this fails: `make docs`."""
    commands = make_commands.PAGE.read_text(encoding="utf-8")
    assert commands == make_commands.generated_page(helps), "commands.md: make docs"
    picture = make_architecture.PICTURE.read_text(encoding="utf-8")
    assert picture == make_architecture.picture(), "architecture.svg: make docs"


def test_the_command_lines_in_the_documentation_have_flags_that_exist(flags: dict[str, set[str]]) -> None:
    lines = list(command_lines())
    assert lines
    wrong = []
    for page, line in lines:
        words = shlex.split(line, comments=True)
        existing = flags.get(" ".join(words[:2]), flags.get(words[0]))
        unknown = {word.split("=")[0] for word in words if word.startswith("--")} - (existing or set())
        if existing is None or unknown - {"--help", "--help-all"}:
            wrong.append(f"{page}: {line}")
    assert wrong == []


@pytest.mark.long
def test_the_examples_of_the_documentation_run(tmp_path: Path) -> None:
    """The release workflow runs them from an installed wheel."""
    program = ROOT / "docs" / "run_examples.py"
    done = subprocess.run([sys.executable, program, tmp_path / "examples"], check=False, stdout=subprocess.DEVNULL)
    assert done.returncode == 0


def test_the_pictures_and_pages_that_the_documentation_shows_are_there() -> None:
    missing = [
        f"{page.name}: {target}"
        for page in PAGES
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
        if "://" not in target and not (page.parent / target).exists()
    ]
    assert missing == []


def test_the_readmes_moving_picture_loads_fast_and_begins_again() -> None:
    path = ROOT / "docs" / "pictures" / "drive-train-drive.webp"
    assert path.stat().st_size < 3e6
    shown_ms = 0
    with Image.open(path) as picture:
        assert (picture.width, picture.info["loop"]) == (640, 0)
        for frame in ImageSequence.Iterator(picture):
            frame.load()
            shown_ms += frame.info["duration"]
    assert 12_000 <= shown_ms <= 20_000


@pytest.mark.parametrize("name", ["ARCHITECTURE.md", "CONTRIBUTING.md", "SECURITY.md", "docs/glossary.md"])
def test_the_files_that_a_page_names_are_there(name: str) -> None:
    code = re.findall(r"`([\w./-]+)`", (ROOT / name).read_text(encoding="utf-8"))
    named = {place for place in code if place.endswith(("/", ".py", ".md", ".toml", ".proto", ".yml", ".txt"))}
    paths = {place for place in named if not place.startswith(WRITTEN_BY_COMMANDS) and "YOUR" not in place}
    missing = {path for path in paths if not (ROOT / path).exists() and ("/" in path or not named_so(path))}
    assert missing == set()


def test_what_workflows_and_pages_show_to_run_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    workflows = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
    texts = [path.read_text(encoding="utf-8") for path in (*PAGES, *workflows, ROOT / ".ci" / "run")]
    reported = re.findall(r"(?:`|^ *|run: )make (?:-j )?([a-z -]+?)(?=`|\s+#|$)", "\n".join(texts), re.MULTILINE)
    assert set(" ".join(reported).split()) - targets == set()
    program = re.compile(r"(?<!:)\b((?:tests|docs|benchmarks|studies)/[\w/]+\.py)")  # not COMMIT:path
    paths = {path for text in texts for path in program.findall(text)}
    assert {path for path in paths if not (ROOT / path).exists()} == set()


def named_so(name: str) -> bool:
    """`cli.py` stands for the files of that name in every room."""
    return any(ROOT.glob(f"*/{name}"))


def test_the_lines_that_troubleshooting_quotes_are_printed() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    quoted = re.findall(r"`([^`]+)`", "".join(re.findall(r"^> .*$", page, re.MULTILINE)))
    assert len(quoted) > 25
    texts = {text for path in SOURCES for text in texts_in(path)}
    not_printed = []
    for line in quoted:
        pattern = re.compile(".*".join(map(re.escape, line.split("…"))), re.DOTALL)
        if not any(pattern.search(text) for text in texts):
            not_printed.append(line)
    assert not_printed == []


def texts_in(path: Path) -> Iterator[str]:
    """The string literals of a module; in those with expressions, an ellipsis stands for each."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_no_page_installs_the_toolkit_from_an_index_that_lacks_it() -> None:
    install = r"(?:pip|pipx|uv tool) install [^`\n]*behavioural-cloning-toolkit[^`\n]*"
    pages = [page for page in PAGES if page.name != "CHANGELOG.md"]
    lines = [line for page in pages for line in re.findall(install, page.read_text(encoding="utf-8"))]
    assert [line for line in lines if "@ git+" not in line] == []


def test_no_file_names_a_place_on_one_persons_machine() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a git checkout: what belongs to the project is not known")
    place = re.compile(rb"(?<![\w.])/(?:work|root|tmp/w)(?:/|\b)")
    naming = []
    for name in listed.stdout.decode().split("\0"):
        path = ROOT / name
        if name and path.is_file() and path != Path(__file__):
            data = path.read_bytes()
            if b"\0" not in data and place.search(data):
                naming.append(name)
    assert naming == []
