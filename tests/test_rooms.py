"""The rooms of the code: who may import or start whom, what stays unloaded, and that nothing is ever unpickled."""

from __future__ import annotations

import ast
import functools
import importlib
import itertools
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.driving import run_code
from tests.helpers.repository import ROOT

# Each room imports from those under it only; `common` is the floor under all of them (ARCHITECTURE.md).
MAY_IMPORT = {
    "common": set[str](),
    "simulator": {"common"},
    "recorder": {"common", "simulator"},
    "dataset": {"common", "recorder"},
    "model": {"common", "dataset"},
    "viz": {"common", "dataset", "model", "recorder"},
    "drive": {"common", "viz", "model", "dataset", "recorder", "simulator"},
    "web": {"common", "drive", "viz", "model", "dataset", "recorder"},
}
# Within a room each folder imports from those before it only (ARCHITECTURE.md).
FOLDERS: dict[str, list[str]] = {
    "common": [],
    "simulator": ["roads", "rendering", "driving", "protocol"],
    "recorder": ["pictures", "mcap", "rows", "seen", "log", "upkeep", "server", "teleop", "lerobot", "sources"],
    "dataset": ["frames", "samples", "index", "loader"],
    "model": ["network", "runs", "evaluation", "training"],
    "viz": ["playback", "live"],
    "drive": ["control", "log", "evaluation"],
    "web": ["folders", "jobs", "processes", "logs", "index", "runs", "server", "pages"],
}
SOURCES = sorted(path for room in MAY_IMPORT for path in (ROOT / room).rglob("*.py"))
MODULES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in SOURCES}


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


@functools.cache
def imported(path: Path) -> list[tuple[int, str]]:
    """Line and full name of every import in a file, also of those within functions."""
    return list(_imported(path))


def _imported(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are written in full"
            yield node.lineno, node.module or ""


@functools.cache
def started(path: Path) -> list[tuple[int, str]]:
    """Line and full name of every module of ours that a file names in a string, to be imported or run."""
    return list(_started(path))


def _started(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(parsed(path)):
        match node:
            case ast.Constant(value=str(name)) if "." in name and name in MODULES:
                yield node.lineno, name
            case ast.Call(args=[ast.Constant(value=str(name)), *_]) if "import_module" in ast.unparse(node.func):
                yield node.lineno, name
            case ast.List(elts=words) | ast.Tuple(elts=words):
                values = [word.value if isinstance(word, ast.Constant) else None for word in words]
                yield from (
                    (node.lineno, name)
                    for flag, name in itertools.pairwise(values)
                    if flag == "-m" and isinstance(name, str)
                )


def folder_in(room: str, name: str) -> str | None:
    """The folder of `room` that a module is in; None for another room's, and for one directly in the room."""
    first, *rest = name.split(".")
    return rest[0] if first == room and rest and (ROOT / room / rest[0]).is_dir() else None


def test_every_folder_with_code_is_a_room() -> None:
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"tests"}
    assert folders == set(MAY_IMPORT)


def test_the_architecture_shows_the_rooms_and_their_folders_in_this_order() -> None:
    page = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) ?\|$", page, re.MULTILINE)
    below = {room: set(re.findall(r"`(\w+)`", names)) for room, names, _ in rows}
    assert {room: rooms | ({"common"} - {room}) for room, rooms in below.items()} == MAY_IMPORT
    assert {room: re.findall(r"`(\w+)`", names) for room, _, names in rows} == FOLDERS


def test_every_folder_of_a_room_is_reported() -> None:
    folders = {room: {path.parent.name for path in (ROOT / room).glob("*/__init__.py")} for room in MAY_IMPORT}
    assert {room: set(names) for room, names in FOLDERS.items()} == folders


def test_a_room_imports_and_starts_only_those_under_it() -> None:
    """Only the entry module names every room; a program of a room above is started through it."""
    upwards = []
    for path in SOURCES:
        room = path.relative_to(ROOT).parts[0]
        above = MAY_IMPORT.keys() - MAY_IMPORT[room] - {room}
        named = (*imported(path), *started(path))
        upwards += [f"{path}:{line} names {name}" for line, name in named if name.split(".")[0] in above]
    assert upwards == []


def test_the_folders_of_a_room_import_only_those_before_them() -> None:
    upwards = []
    for path in SOURCES:
        room, *folders, _ = path.relative_to(ROOT).parts
        if not folders:  # directly in the room
            continue
        allowed = {None, *FOLDERS[room][: FOLDERS[room].index(folders[0]) + 1]}
        named = (*imported(path), *started(path))
        upwards += [f"{path}:{line} names {name}" for line, name in named if folder_in(room, name) not in allowed]
    assert upwards == []


def test_no_two_modules_have_the_same_name() -> None:
    """But those that every room may have."""
    places = defaultdict(list)
    for path in SOURCES:
        if path.stem not in {"__init__", "cli", "config", "errors"}:
            places[path.stem].append(str(path.relative_to(ROOT)))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_no_two_public_classes_have_the_same_name() -> None:
    """A log's messages are such classes, too."""
    places = defaultdict(list)
    for path in SOURCES:
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(ROOT)))
    for path in (ROOT / "recorder").rglob("*.proto"):
        for name in re.findall(r"^message (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE):
            places[name].append(str(path.relative_to(ROOT)))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


# A name says what a thing is: received, reported, stored, listed, a message; never who tells what to whom.
RIDDLES = {"told", "tell", "tells", "said", "say", "says", "seen", "who", "whom", "whose", "whoever"}
NO_RIDDLES = {
    "seen",  # the documented keyword of `load` and `SamplesDataset`; and a set of what a loop has met
    "tell",  # of a file object
    "tell_world",  # the flag of bc-sim
}


def named(path: Path) -> Iterator[tuple[int, str]]:
    """Line and name of a file itself, and of each function, class, parameter, variable and attribute in it."""
    yield 1, path.stem
    for node in ast.walk(parsed(path)):
        match node:
            case (
                ast.FunctionDef(name=name)
                | ast.AsyncFunctionDef(name=name)
                | ast.ClassDef(name=name)
                | ast.arg(arg=name)
                | ast.Name(id=name, ctx=ast.Store())
                | ast.Attribute(attr=name, ctx=ast.Store())
            ):
                yield node.lineno, name


def is_riddle(name: str) -> bool:
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    return name not in NO_RIDDLES and not RIDDLES.isdisjoint(map(str.lower, words))


def test_names_are_the_words_of_the_field() -> None:
    examples = sorted((ROOT / "examples").glob("*.py"))
    code = [*SOURCES, ROOT / "behavioural_cloning_toolkit.py", *examples]
    assert [f"{path}:{line} {name}" for path in code for line, name in named(path) if is_riddle(name)] == []


def test_no_room_imports_tests_benchmarks_or_studies() -> None:
    others = {"tests", "benchmarks", "studies"}
    assert [path for path in SOURCES for _, name in imported(path) if name.split(".")[0] in others] == []


@pytest.mark.parametrize(
    ("rooms", "unloaded"),
    [
        (
            "dataset, model, model.training",
            ["rerun", "socketio", "engineio", "eventlet", "websocket", "obstore", "viz", "drive"],
        ),
        (
            "recorder, simulator",
            ["rerun", "socketio", "eventlet", "torch", "gymnasium", "starlette", "obstore"],
        ),
        ("viz, viz.cli", ["socketio", "eventlet", "torch", "websocket"]),
        ("model.runs_cli, model.runs.run_summary", ["cv2", "pyarrow", "torch"]),
    ],
)
def test_a_room_loads_only_what_it_needs(rooms: str, unloaded: list[str]) -> None:
    code = f"import sys, {rooms}; print(*(name for name in {unloaded} if name in sys.modules))"
    done = run_code(code)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


def test_a_command_starts_without_typeguard() -> None:
    """To load it takes 50 ms, a sixth of a start."""
    start = "import sys; sys.argv = ['bc-log', 'info', 'none.mcap']; from recorder.log_cli import main"
    done = run_code(f"{start}\ntry:\n    main()\nfinally:\n    print('typeguard' in sys.modules)")
    assert done.stdout.strip() == "False"
    assert "none.mcap" in done.stderr


def test_nothing_is_ever_unpickled() -> None:
    """A run or a log from somebody else must not be able to run code here."""
    modules = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
    for path in SOURCES:
        assert [name for _, name in imported(path) if name.split(".")[0] in modules] == [], path
        for node in ast.walk(parsed(path)):
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            assert called not in {"torch.load", "torch.jit.load", "eval", "exec", "__import__"}, (
                f"{path}: {called}"
            )
            flags = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            assert flags.get("allow_pickle", "False") == "False", f"{path}:{node.lineno}"
            assert flags.get("shell", "False") == "False", f"{path}:{node.lineno}"


@pytest.mark.parametrize(
    ("call", "only_in"),
    [
        ("imdecode(", {"recorder/pictures/picture_size.py"}),  # its limits hold for every picture
        (".resolve()", set()),  # raises for a link that leads to itself: common.untrusted.real_path
    ],
)
def test_what_untrusted_files_may_abuse_is_called_in_one_place(call: str, only_in: set[str]) -> None:
    callers = {str(path.relative_to(ROOT)) for path in SOURCES if call in path.read_text(encoding="utf-8")}
    assert callers == only_in


@pytest.mark.parametrize("room", ["model", "drive"])
def test_a_rooms_public_names_are_not_hidden_by_its_modules(room: str) -> None:
    """They are imported when first used; a module of the same name would then stand in their place."""
    package = importlib.import_module(room)
    for module in {path.stem for path in (ROOT / room).glob("*.py")}.intersection(package.__all__):
        with pytest.raises(ImportError):  # only to be run, with `python -m`
            importlib.import_module(f"{room}.{module}")
    for name in package.__all__:
        assert getattr(package, name).__module__.startswith(f"{room}.")


def test_names_of_tests_have_fewer_than_70_characters() -> None:
    files = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    names = re.findall(r"^def (test_\w+)", "\n".join(files), re.MULTILINE)
    assert len(names) > 1000
    assert [name for name in names if len(name) >= 70] == []
