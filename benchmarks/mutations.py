"""How many of a fixed sample of small faults in the product the tests catch.

make coverage
python benchmarks/mutations.py mutations.jsonl

An older version, with its own `make coverage`, is tried on the same faults, as far as both have those lines:

python benchmarks/mutations.py before.jsonl --tree ../before
python benchmarks/mutations.py after.jsonl --like before.jsonl

Each fault is put into a copy of the tree, and there the tests run that execute its line, quickest first. Results
are written one by one; the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ElementTree
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from coverage import CoverageData
from mutation_points import Fault, all_faults, same_as, sample

TIMEOUT: Final = "timeout"
TESTS_S, LIMIT_S = 30.0, 400.0  # tests for one fault take so long by the times of `make coverage`; and at most


class Tests:
    """The tests that run a line, quickest first, as `make coverage` has measured them."""

    def __init__(self, folder: Path) -> None:
        self._data = CoverageData(str(folder / "data"))
        self._data.read()
        self._lines: dict[str, dict[int, list[str]]] = {}
        cases = ElementTree.parse(folder / "junit.xml").iter("testcase")
        self._seconds = {
            f"{case.get('classname')}::{case.get('name')}": float(case.get("time", 0)) for case in cases
        }

    def of(self, fault: Fault) -> list[str]:
        """Their ids, up to TESTS_S."""
        if fault.file not in self._lines:
            names = [path for path in self._data.measured_files() if path.endswith("/" + fault.file)]
            name = min(names, key=len, default="")  # not one of the copies that a test made
            self._lines[fault.file] = self._data.contexts_by_lineno(name) if name else {}
        tests = (test for test in self._lines[fault.file].get(fault.lineno, []) if "::" in test)
        ids = {re.sub(r" \((setup|call|teardown)\)$", "", test) for test in tests}
        timed = sorted((self._time(test), test) for test in ids)
        spent = itertools.accumulate(seconds for seconds, _ in timed)
        return [test for at, ((_, test), s) in enumerate(zip(timed, spent, strict=True)) if not at or s <= TESTS_S]

    def _time(self, test: str) -> float:
        file, _, name = test.partition("::")
        return self._seconds.get(f"{file.removesuffix('.py').replace('/', '.')}::{name}", 1.0)


class Trial:
    """A copy of the tree with an environment of its own: nobody else sees the fault."""

    def __init__(self, tree: Path, folder: Path) -> None:
        self._tree, self._folder = folder / "tree", folder
        ignored = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__", ".*_cache")
        shutil.copytree(tree, self._tree, ignore=ignored)
        environment = self._tree / ".venv"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
        (packages,) = environment.glob("lib/python*/site-packages")
        (packages / "copy.pth").write_text(f"{self._tree}\n{sysconfig.get_path('purelib')}\n")
        for script in Path(sysconfig.get_path("scripts")).glob("bc-*"):
            code = script.read_text().partition("\n")[2]
            (environment / "bin" / script.name).write_text(f"#!{environment}/bin/python\n{code}")
            (environment / "bin" / script.name).chmod(0o755)
        recordings = os.environ.get("BC_RECORDINGS", str(tree.parent / "shared" / "recordings"))
        own = {
            "PYTHONDONTWRITEBYTECODE": "1",
            "XDG_CACHE_HOME": str(folder / "cache"),
            "BC_RECORDINGS": recordings,
        }
        self._environ = os.environ | own  # no bytecode: a change within the same second would not be seen
        self._passes: dict[str, bool] = {}

    def catch(self, fault: Fault, tests: list[str]) -> str | None:
        """The test that fails with the fault and passes without, TIMEOUT, or None."""
        path = self._tree / fault.file
        sound = path.read_bytes()
        while tests:
            path.write_bytes(sound[: fault.start] + fault.text.encode() + sound[fault.end :])
            try:
                failed = self._first_failure(tests)
            finally:
                path.write_bytes(sound)
            if failed in tests and failed not in self._passes:
                self._passes[failed] = self._first_failure([failed]) is None
            if failed == TIMEOUT and self._first_failure(tests) == TIMEOUT:
                return None  # so they do without it
            if failed is None or self._passes.get(failed, True):
                return failed
            tests = [test for test in tests if test != failed]
        return None

    def _first_failure(self, tests: list[str]) -> str | None:
        flags = ["-x", "-rfE", "--tb=no", "-p", "no:cacheprovider", "-m", "", f"--basetemp={self._folder / 'tmp'}"]
        line = [".venv/bin/python", "-m", "pytest", *flags, *tests]
        with tempfile.TemporaryFile("w+", errors="replace") as out:
            process = subprocess.Popen(
                line, cwd=self._tree, env=self._environ, stdout=out, stderr=out, start_new_session=True
            )
            try:
                code = process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                return TIMEOUT
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            out.seek(0)
            found = re.search(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", out.read(), re.MULTILINE)
        return None if code == 0 else found[1] if found else f"pytest ended with {code}"


def main() -> None:
    """Print what became of each fault, and how many were caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("--tree", type=Path, default=Path(), help="the version to try (default: here)")
    parser.add_argument("--coverage", type=Path, help="default: build/coverage in it")
    parser.add_argument("--like", type=Path, help="results of another version: its faults, instead of a sample")
    parser.add_argument("--number", type=int, default=140)
    parser.add_argument("--seed", type=int, default=15)
    options = parser.parse_args()
    tree = options.tree.resolve()
    tests = Tests(options.coverage or tree / "build" / "coverage")
    candidates = all_faults(tree)
    others = {one["id"]: one for one in read(options.like)} if options.like else {}
    if options.like:
        pairs = [(number, same_as(other, candidates)) for number, other in others.items()]
    else:
        pairs = list(
            enumerate(sample([each for each in candidates if tests.of(each)], options.number, options.seed))
        )
    done = {one["id"]: one for one in read(options.results)} if options.results.exists() else {}
    with tempfile.TemporaryDirectory() as folder, options.results.open("a") as results:
        trial = Trial(tree, Path(folder))
        for number, fault in pairs:
            if fault is not None and number not in done:
                selected = tests.of(fault)
                by = trial.catch(fault, selected)
                done[number] = {"id": number, "by": by, "tests": len(selected), **asdict(fault)}
                results.write(json.dumps(done[number]) + "\n")
                results.flush()
                print(f"{number:3} {'caught' if by else 'SURVIVED'} {said(done[number])}", flush=True)
    print(f"{sum(one['by'] is not None for one in done.values())} of {len(done)} caught; sample: {len(pairs)}")
    if others:
        print(f"of the same, {sum(others[number]['by'] is not None for number in done)} in {options.like}")
    for number, one in sorted(done.items()):
        if number in others and (one["by"] is None) != (others[number]["by"] is None):
            print(f"{'now caught' if one['by'] else 'NOW SURVIVES'}: {said(one)}")


def read(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def said(one: dict[str, Any]) -> str:
    return f"{one['file']}:{one['lineno']} {one['operator']}: {one['line']}"


if __name__ == "__main__":
    main()
