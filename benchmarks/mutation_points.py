"""Small faults that can be put into the product, a sample of them, and the same ones in another version."""

from __future__ import annotations

import ast
import copy
import difflib
import random
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOMS = ("common", "simulator", "recorder", "dataset", "model", "viz", "drive")
PAIRS: list[tuple[type[ast.AST], type[ast.AST]]] = [
    *((ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn)),
    *((ast.And, ast.Or), (ast.Add, ast.Sub), (ast.Mult, ast.Div)),
]
SWAPPED = dict(PAIRS) | {b: a for a, b in PAIRS} | {ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult}
WORD = re.compile(r"[^\W\d]\w*")


@dataclass(frozen=True)
class Fault:
    """One change of one line; another version's has the same shape, and the most similar `around`."""

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


def with_fields(node: ast.AST, **changed: object) -> ast.AST:
    new = copy.copy(node)
    vars(new).update(changed)
    return new


def changes(node: ast.AST) -> Iterator[tuple[str, Any, ast.AST]]:
    """The operator, the node that is replaced, and what replaces it."""
    match node:
        case ast.Compare() if type(node.ops[0]) in SWAPPED:
            ops = [SWAPPED[type(node.ops[0])](), *node.ops[1:]]
            yield type(node.ops[0]).__name__, node, with_fields(node, ops=ops)
        case ast.BinOp() | ast.BoolOp() if type(node.op) in SWAPPED:
            yield type(node.op).__name__, node, with_fields(node, op=SWAPPED[type(node.op)]())
        case ast.UnaryOp(op=ast.Not()):
            yield "Not", node, node.operand
        case ast.Constant(value=bool(value)):
            yield "Bool", node, ast.Constant(not value)
        case ast.Constant(value=int(number) | float(number)):
            yield "Number", node, ast.Constant(number + 1)
        case ast.Return(value=ast.expr()):
            yield "Return", node, ast.Return(None)
        case ast.If() | ast.While() | ast.IfExp():
            yield "Condition", node.test, ast.UnaryOp(ast.Not(), node.test)
        case ast.Expr(value=ast.Call()):
            yield "Call", node, ast.Pass()


def faults_in(tree: Path, path: Path) -> Iterator[Fault]:
    """Every fault that can be put into a file's functions, but for f-strings, annotations and defaults."""
    lines = path.read_bytes().splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))
    seen: Counter[tuple[str, str, str]] = Counter()

    def visit(node: ast.AST, function: str) -> Iterator[Fault]:
        for operator, old, new in changes(node) if function else ():
            if ast.dump(old) == ast.dump(new):
                continue
            text = ast.unparse(ast.fix_missing_locations(new))
            if isinstance(new, ast.expr) and not isinstance(new, ast.Constant):
                text = f"({text})"
            line = lines[old.lineno - 1].decode().strip()
            seen[function, line, operator] += 1
            around = b"".join(lines[max(0, old.lineno - 6) : old.lineno + 5]).decode()
            where = path.relative_to(tree).as_posix(), old.lineno, function, line, operator
            start, end = starts[old.lineno - 1] + old.col_offset, starts[old.end_lineno - 1] + old.end_col_offset
            yield Fault(*where, seen[function, line, operator], around, start, end, text)
        within = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        inner = f"{function}.{node.name}".lstrip(".") if within else function  # type: ignore[attr-defined]
        for field, value in ast.iter_fields(node):
            if field not in ("annotation", "returns", "args", "decorator_list") or isinstance(node, ast.Call):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                        yield from visit(child, inner)

    yield from visit(ast.parse(path.read_bytes()), "")


def all_faults(tree: Path) -> list[Fault]:
    """Those of all rooms."""
    sources = [path for room in ROOMS for path in sorted((tree / room).rglob("*.py")) if "_pb2" not in path.name]
    return [fault for path in sources for fault in faults_in(tree, path)]


def sample(candidates: list[Fault], number: int, seed: int) -> list[Fault]:
    """As many of each room, and no two of one function."""
    chance = random.Random(seed)
    chosen: list[Fault] = []
    for room in ROOMS:
        by_function = defaultdict(list)
        for fault in candidates:
            if fault.file.startswith(room + "/"):
                by_function[fault.file, fault.function].append(fault)
        functions = chance.sample(sorted(by_function), min(len(by_function), -(-number // len(ROOMS))))
        chosen += [chance.choice(by_function[function]) for function in functions]
    chance.shuffle(chosen)  # a part of them is a sample, too
    return chosen


def same_as(wanted: dict[str, Any], candidates: list[Fault]) -> Fault | None:
    """Another version's fault here: files and names may have changed."""
    shape = WORD.sub("x", wanted["line"])

    def likeness(fault: Fault) -> float:
        same_names = sum(getattr(fault, name) == wanted[name] for name in ("function", "line"))
        return float(difflib.SequenceMatcher(None, wanted["around"], fault.around).ratio() + 0.2 * same_names)

    same = [each for each in candidates if all(getattr(each, n) == wanted[n] for n in ("operator", "occurrence"))]
    best = max((each for each in same if WORD.sub("x", each.line) == shape), key=likeness, default=None)
    return best if best is not None and likeness(best) > 0.6 else None
