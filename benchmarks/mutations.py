"""Which of a fixed sample of small faults in the product the tests find.

make coverage
python benchmarks/mutations.py build/mutations.jsonl

A version whose files and names are others is compared on the same faults, as far as it has those lines:

python benchmarks/mutations.py before.jsonl --tree ../before
python benchmarks/mutations.py after.jsonl --like before.jsonl

Each fault is put into a copy of the tree, and the tests that run that line are run there, quickest first. Results are
appended one by one: the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import ast
import copy
import difflib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from coverage import CoverageData

ROOMS = ("common", "simulator", "recorder", "dataset", "model", "viz", "drive")
SWAPPED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
}  # fmt: skip
TESTS_S = 60.0  # the tests that are tried for one fault take so long at most, by the times of `make coverage`


@dataclass(frozen=True)
class Fault:
    """One change of one line; `around` are the lines about it, by which it is found in another version."""

    file: str
    lineno: int
    function: str
    line: str
    operator: str
    occurrence: int
    around: str
    start: int  # what is replaced, in bytes of the file
    end: int
    text: str


def changes(node: ast.AST) -> Iterator[tuple[str, ast.AST, ast.AST]]:
    """The faults of one node: the operator's name, the node that is replaced, and what replaces it."""
    match node:
        case ast.Compare(ops=[op, *_]):
            new = copy.deepcopy(node)
            new.ops[0] = SWAPPED[type(op)]()
            yield type(op).__name__, node, new
        case ast.BinOp(op=op) | ast.BoolOp(op=op) if type(op) in SWAPPED:
            swapped = copy.deepcopy(node)
            swapped.op = SWAPPED[type(op)]()
            yield type(op).__name__, node, swapped
        case ast.UnaryOp(op=ast.Not()):
            yield "Not", node, node.operand
        case ast.Constant(value=bool(value)):
            yield "Bool", node, ast.Constant(not value)
        case ast.Constant(value=int(number) | float(number)):
            yield "Number", node, ast.Constant(number + 1)
        case ast.Return(value=ast.expr()) if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            yield "Return", node, ast.Return(None)
        case ast.If() | ast.While() | ast.IfExp():
            yield "Condition", node.test, ast.UnaryOp(ast.Not(), node.test)
        case ast.Expr(value=ast.Call()):
            yield "Call", node, ast.Pass()


def faults(tree: Path, path: Path) -> list[Fault]:
    """Every fault that can be put into the functions of a file."""
    source = path.read_text(encoding="utf-8")
    lines = source.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line.encode()))
    found: list[Fault] = []
    seen: Counter[tuple[str, str, str]] = Counter()

    def visit(node: ast.AST, function: str) -> None:
        if isinstance(node, ast.JoinedStr | ast.arguments):  # places in f-strings are not told; defaults are no lines
            return
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{function}.{node.name}".lstrip(".")
            for child in node.body:
                visit(child, name)
            return
        for operator, old, new in changes(node) if function else ():
            assert isinstance(old, ast.expr | ast.stmt)
            assert old.end_lineno is not None and old.end_col_offset is not None
            start, end = starts[old.lineno - 1] + old.col_offset, starts[old.end_lineno - 1] + old.end_col_offset
            text = ast.unparse(ast.fix_missing_locations(new))
            text = f"({text})" if isinstance(new, ast.expr) and not isinstance(new, ast.Constant) else text
            line, lineno = lines[old.lineno - 1].strip(), old.lineno
            seen[function, line, operator] += 1
            around = "".join(lines[max(0, lineno - 6) : lineno + 5])
            found.append(
                Fault(path.relative_to(tree).as_posix(), lineno, function, line, operator,
                      seen[function, line, operator], around, start, end, text)  # fmt: skip
            )
        for field, child in ast.iter_fields(node):
            for item in child if isinstance(child, list) else [child]:
                if isinstance(item, ast.AST) and field not in ("annotation", "returns"):
                    visit(item, function)

    visit(ast.parse(source), "")
    return found


def faults_of(tree: Path) -> list[Fault]:
    """Those of all rooms."""
    return [
        fault
        for room in ROOMS
        for path in sorted((tree / room).rglob("*.py"))
        if not path.name.endswith("_pb2.py")
        for fault in faults(tree, path)
    ]


def sample(candidates: list[Fault], number: int, seed: int) -> list[Fault]:
    """As many from each room, and no two from one function."""
    chance = random.Random(seed)
    chosen: list[Fault] = []
    for room in ROOMS:
        by_function = defaultdict(list)
        for fault in candidates:
            if fault.file.startswith(room + "/"):
                by_function[fault.file, fault.function].append(fault)
        functions = chance.sample(sorted(by_function), min(len(by_function), -(-number // len(ROOMS))))
        chosen += [chance.choice(by_function[function]) for function in functions]
    chance.shuffle(chosen)  # so that a part of them is a sample, too
    return chosen


def same_in(wanted: dict[str, Any], candidates: list[Fault]) -> Fault | None:
    """The fault of another version in this one: the line but for its names, in the most similar surroundings."""
    shape = re.sub(r"[^\W\d]\w*", "x", wanted["line"])
    alike = [
        fault
        for fault in candidates
        if fault.operator == wanted["operator"]
        and fault.occurrence == wanted["occurrence"]
        and re.sub(r"[^\W\d]\w*", "x", fault.line) == shape
    ]

    def likeness(fault: Fault) -> float:
        about = difflib.SequenceMatcher(None, wanted["around"], fault.around, autojunk=False).ratio()
        return about + (fault.function == wanted["function"]) * 0.2 + (fault.line == wanted["line"]) * 0.2

    best = max(alike, key=likeness, default=None)
    return best if best is not None and likeness(best) > 0.6 else None


class Tests:
    """The tests that run a line, quickest first, by what `make coverage` has measured."""

    def __init__(self, tree: Path, data: Path, times: Path) -> None:
        self._data = CoverageData(str(data))
        self._data.read()
        measured = self._data.measured_files()
        self._files = {path: name for name in measured for path in self._tails(name)}
        self._lines: dict[str, dict[int, list[str]]] = {}
        self._seconds = {
            f"{case.get('classname')}::{case.get('name')}": float(case.get("time", "0"))
            for case in ET.parse(times).iter("testcase")
        }

    @staticmethod
    def _tails(name: str) -> list[str]:
        parts = Path(name).parts
        return ["/".join(parts[at:]) for at, part in enumerate(parts) if part in ROOMS]

    def seconds(self, test: str) -> float:
        file, _, name = test.partition("::")
        return self._seconds.get(f"{file.removesuffix('.py').replace('/', '.')}::{name}", 1.0)

    def of(self, fault: Fault) -> list[str]:
        name = self._files.get(fault.file)
        if name is None:
            return []
        if name not in self._lines:
            self._lines[name] = self._data.contexts_by_lineno(name)
        tests = {test.removesuffix(" (call)").removesuffix(" (setup)") for test in self._lines[name].get(fault.lineno, [])}
        return sorted((test for test in tests if test.startswith("tests/")), key=lambda test: (self.seconds(test), test))


class Copy:
    """A copy of the tree with an environment of its own, in which a test run sees the fault and nobody else does."""

    def __init__(self, tree: Path, folder: Path) -> None:
        self.folder = folder / tree.name
        ignored = shutil.ignore_patterns(".git", ".venv", "build", "*.egg-info", "__pycache__", ".*_cache")
        shutil.copytree(tree, self.folder, ignore=ignored)
        environment = self.folder / ".venv"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
        packages = sysconfig.get_path("purelib")
        (own,) = environment.glob("lib/python*/site-packages")
        (own / "copy.pth").write_text(f"{self.folder}\n{packages}\n")
        for script in Path(sysconfig.get_path("scripts")).glob("bc-*"):
            text = script.read_text().partition("\n")[2]
            (environment / "bin" / script.name).write_text(f"#!{environment}/bin/python\n{text}")
            (environment / "bin" / script.name).chmod(0o755)
        self._environ = os.environ | {
            "PYTHONDONTWRITEBYTECODE": "1",  # what was compiled before a change of the same length would be taken
            "XDG_CACHE_HOME": str(folder / "cache"),
            "BC_RECORDINGS": os.environ.get("BC_RECORDINGS", str(tree.parent / "shared" / "recordings")),
        }
        self._sound: dict[str, bool] = {}

    def failed(self, tests: list[str], limit_s: float) -> str | None:
        """The first test that fails, "timeout", or None."""
        command = [".venv/bin/python", "-m", "pytest", "-x", "-rfE", "--tb=no", "-p", "no:cacheprovider", "-m", ""]
        with tempfile.TemporaryFile("w+") as out:
            process = subprocess.Popen([*command, f"--basetemp={self.folder.parent / 'tmp'}", *tests], cwd=self.folder,
                                       env=self._environ, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                                       start_new_session=True)  # fmt: skip
            try:
                code = process.wait(limit_s)
            except subprocess.TimeoutExpired:
                return "timeout"
            finally:
                with_children = process.pid
                try:
                    os.killpg(with_children, signal.SIGKILL)
                except ProcessLookupError:
                    pass
                process.wait()
            if code == 0:
                return None
            out.seek(0)
            named = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", out.read(), re.MULTILINE)
            return named[1] if named else f"pytest ended with {code}"

    def caught(self, fault: Fault, tests: list[str], limit_s: float) -> str | None:
        """What catches a fault, or None; a test counts that passes without it."""
        path = self.folder / fault.file
        sound = path.read_bytes()
        faulty = sound[: fault.start] + fault.text.encode() + sound[fault.end :]
        compile(faulty, fault.file, "exec")
        while tests:
            path.write_bytes(faulty)
            try:
                failed = self.failed(tests, limit_s)
            finally:
                path.write_bytes(sound)
            if failed not in tests:
                return failed
            if failed not in self._sound:
                self._sound[failed] = self.failed([failed], limit_s) is None
            if self._sound[failed]:
                return failed
            tests = [test for test in tests if test != failed]
        return None


def main() -> None:
    """Print each fault's outcome, and how many of them were caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("--tree", type=Path, default=Path(), help="the version that is tried (default: this one)")
    parser.add_argument("--like", type=Path, help="results of another version: its faults")
    parser.add_argument("--coverage", type=Path, help="what `make coverage` left there (default: TREE/build/coverage)")
    parser.add_argument("--number", type=int, default=140)
    parser.add_argument("--seed", type=int, default=15)
    options = parser.parse_args()
    tree = options.tree.resolve()
    measured = options.coverage or tree / "build" / "coverage"
    tests = Tests(tree, measured / "data", measured / "junit.xml")
    candidates = faults_of(tree)
    if options.like:
        wanted = [json.loads(line) for line in options.like.read_text().splitlines()]
        pairs = [(one["id"], same_in(one, candidates)) for one in wanted]
    else:
        chosen = sample([fault for fault in candidates if tests.of(fault)], options.number, options.seed)
        pairs = list(enumerate(chosen))
    done = {}
    if options.results.exists():
        done = {one["id"]: one for one in map(json.loads, options.results.read_text().splitlines())}
    with tempfile.TemporaryDirectory() as folder, options.results.open("a") as results:
        trial = Copy(tree, Path(folder))
        for number, fault in pairs:
            if fault is None or number in done:
                continue
            tried: list[str] = []
            total = 0.0
            for test in tests.of(fault):
                total += tests.seconds(test)
                if tried and total > TESTS_S:
                    break
                tried.append(test)
            by = trial.caught(fault, tried, 60 + 4 * TESTS_S)
            done[number] = {"id": number, "caught": by is not None, "by": by, "tests": len(tried), **asdict(fault)}
            results.write(json.dumps(done[number]) + "\n")
            results.flush()
            print(f"{number:4} {'caught' if by else 'SURVIVED':8} {fault.file}:{fault.lineno} {fault.operator}: {fault.line}")
    caught = sum(one["caught"] for one in done.values())
    print(f"{caught} of {len(done)} caught ({len(pairs)} in the sample)")
    if options.like:
        before = {one["id"]: one["caught"] for one in wanted if one["id"] in done}
        print(f"of the same, {sum(before.values())} in {options.like}")
        for number, was in sorted(before.items()):
            if was != done[number]["caught"]:
                one = done[number]
                print(f"{'now survives' if was else 'now caught'}: {one['file']}:{one['lineno']} {one['operator']}: {one['line']}")


if __name__ == "__main__":
    main()
