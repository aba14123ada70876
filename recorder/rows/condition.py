"""Conditions on rows, such as "speed_mph > 5 and 'recovery' in tags", for `bc-log tag`, `bc-index` and `bc-web`.

A condition is parsed as a Python expression, but never run: each part is looked up here, and computed by Arrow.
So a condition from a stranger can only compare columns. Its time and memory are bounded by its length, its depth
and the number of rows.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.errors import UsageError, brief, did_you_mean
from recorder.rows.row_quality import States

LOG_COLUMNS: Final = ("row", "time_s", "steering", "throttle", "brake", "speed_mph")
"""The columns of a log; time_s counts from the log's first row."""

Mask = NDArray[np.bool_]
Values = Any  # pa.ChunkedArray or pa.Scalar: numbers, texts, lists of texts, or truth values

_COMPARE: Final[Mapping[type[ast.cmpop], Callable[..., Values]]] = {
    ast.Lt: pc.less,
    ast.LtE: pc.less_equal,
    ast.Gt: pc.greater,
    ast.GtE: pc.greater_equal,
    ast.Eq: pc.equal,
    ast.NotEq: pc.not_equal,
}
_CALCULATE: Final[Mapping[type[ast.operator], Callable[..., Values]]] = {
    ast.Add: pc.add,
    ast.Sub: pc.subtract,
    ast.Mult: pc.multiply,
    ast.Div: pc.divide,
    ast.Mod: lambda number, by: pc.subtract(number, pc.multiply(by, pc.floor(pc.divide(number, by)))),
}
# Quoted text, a word, a number, or a sign; anything else is refused. Two quotes within a text are one, as in SQL.
_TOKEN: Final = re.compile(
    r"""(?P<text>'(?:[^']|'')*'|"(?:[^"]|"")*")|(?P<word>[A-Za-z_]\w*)"""
    r"""|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<sign><>|[<>=!]=|[-+*/%<>=(),])|(?P<wrong>\S)""",
    re.ASCII,
)
_SIGNS: Final = {"=": "==", "<>": "!="}
_WORDS: Final = {"and": "and", "or": "or", "not": "not", "in": "in", "is": "is", "null": "None"}
_IN_SQL: Final = {
    "between": "5 <= row <= 9",
    "like": "'lake' in session (names that contain lake)",
    "list_contains": "'recovery' in tags",
    "isnan": "speed_mph is null",
    "least": "min",
    "greatest": "max",
}
"""What is written instead, for parts of SQL that the conditions of earlier versions may have."""
_MAX_CHARACTERS: Final = 2000
_MAX_DEPTH: Final = 50
_EXAMPLE: Final = "comparisons such as speed_mph > 5, joined by and, or, not"


def rows_where(table: pa.Table, condition: str) -> Mask:
    """The rows (N,) of a table that meet a condition on its columns: numbers, texts and lists of texts.

    A comparison with an unknown number (null or NaN) is neither true nor false, nor is its `not`: the row is not
    chosen. Raises UsageError for anything else than a condition.
    """
    try:
        values = _Values(table).of(_parsed(condition), 0)
        if _kind(values) != "condition":
            raise _ExpectedError(f"expected {_EXAMPLE}")
    except _ExpectedError as error:
        columns = ", ".join(table.column_names)
        raise UsageError(f"--where {brief(condition)!r}: {error}; columns are {columns}") from None
    if isinstance(values, pa.Scalar):
        return np.full(len(table), bool(values.as_py()))
    holds: Mask = pc.fill_null(values, False).to_numpy().astype(np.bool_)
    return holds


def log_columns(states: States) -> pa.Table:
    """The table of a log's rows, with LOG_COLUMNS."""
    since_s = (states.time_ns - states.time_ns[:1]) / 1e9
    return pa.table({name: since_s if name == "time_s" else getattr(states, name) for name in LOG_COLUMNS})


class _ExpectedError(Exception):
    """What is wrong with a part of a condition."""


def _parsed(condition: str) -> ast.expr:
    if len(condition) > _MAX_CHARACTERS:
        raise _ExpectedError(f"{len(condition):,} characters; at most {_MAX_CHARACTERS:,} are allowed")
    try:
        condition.encode()
    except UnicodeEncodeError:  # of a command line
        raise _ExpectedError("expected text in UTF-8") from None
    python, words = [], []
    for token in _TOKEN.finditer(condition):
        text = token[0]
        match token.lastgroup:
            case "text":
                # the parentheses keep Python from joining two texts without a comma between them
                text = f"({text[1:-1].replace(text[0] * 2, text[0])!r})"
            case "word":
                words.append(text.lower())
                text = _WORDS.get(text.lower(), text)
            case "number":
                text += ".0" if text.isdigit() and int(text) >= 2**63 else ""
            case "wrong":
                raise _ExpectedError(f"unexpected {text!r}; expected {_EXAMPLE}")
        python.append(_SIGNS.get(text, text))
    for word in words:
        if word in _IN_SQL:
            raise _ExpectedError(f"{word} is not known; write {_IN_SQL[word]}")
    try:
        return ast.parse(" ".join(python), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _ExpectedError(f"expected {_EXAMPLE}") from None


class _Values:
    """The values of the parts of a condition."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table
        self._columns: dict[str, Values] = {}

    def of(self, node: ast.expr, depth: int) -> Values:
        if depth > _MAX_DEPTH:
            raise _ExpectedError(f"parts within parts: at most {_MAX_DEPTH} levels are allowed")
        part = functools.partial(self.of, depth=depth + 1)
        match node:
            case ast.BoolOp(op=op, values=parts):
                join = pc.and_kleene if isinstance(op, ast.And) else pc.or_kleene
                return functools.reduce(join, (_of_kind("condition", part(node), node) for node in parts))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return pc.invert(_of_kind("condition", part(operand), operand))
            case ast.Compare(ops=[_, _, *_] as ops) if any(type(op) not in _COMPARE for op in ops):
                raise _ExpectedError(f"expected parentheses around one of the comparisons in {_shown(node)}")
            case ast.Compare(left=left, ops=ops, comparators=others):
                firsts = [left, *others]
                links = (self._compared(*link, part) for link in zip(ops, firsts, others, strict=False))
                return functools.reduce(pc.and_kleene, links)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _CALCULATE:
                return _known(_CALCULATE[type(op)](_float(part(left), left), _float(part(right), right)))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return pc.negate(_float(part(operand), operand))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return _of_kind("number", part(operand), operand)
            case ast.Call(func=ast.Name(id="abs"), args=[only], keywords=[]):
                return pc.abs(_float(part(only), only))
            case ast.Call(func=ast.Name(id="len"), args=[only], keywords=[]):
                return pc.list_value_length(_of_kind("list", part(only), only))
            case ast.Call(func=ast.Name(id="min" | "max" as name), args=[_, _, *_] as args, keywords=[]):
                function = pc.min_element_wise if name == "min" else pc.max_element_wise
                numbers = (_float(part(arg), arg) for arg in args)  # one after another, to hold only two
                return functools.reduce(functools.partial(function, skip_nulls=False), numbers)
            case ast.Name(id=name):
                return self._column(name)
            case ast.Constant(value=int() | float() | str() as value) if not isinstance(value, bool):
                return pa.scalar(value)
            case ast.Constant(value=None):
                raise _ExpectedError("null stands only in is null and is not null")
        raise _ExpectedError(
            f"expected a column, number, quoted text, abs(x), min(x, y), max(x, y) or len(x), not {_shown(node)}"
        )

    def _column(self, name: str) -> Values:
        if name not in self._table.column_names:
            meant = did_you_mean(name, self._table.column_names)
            raise _ExpectedError(f"no column {brief(name, 40)}{f' ({meant})' if meant else ''}")
        if name not in self._columns:
            column = self._table[name]
            if pa.types.is_dictionary(column.type):
                column = column.cast(column.type.value_type)
            self._columns[name] = _known(column)
        return self._columns[name]

    def _compared(self, op: ast.cmpop, left: ast.expr, right: ast.expr, part: Callable[..., Values]) -> Values:
        match op, right:
            case ast.Is() | ast.IsNot(), ast.Constant(value=None):
                if isinstance(values := part(left), pa.StringScalar):
                    raise _quoted(left)
                return pc.is_null(values) if isinstance(op, ast.Is) else pc.is_valid(values)
            case ast.In() | ast.NotIn(), _:
                holds = self._is_in(left, right, part)
                return holds if isinstance(op, ast.In) else pc.invert(holds)
        if type(op) not in _COMPARE:
            raise _ExpectedError(f"expected <, <=, >, >=, =, !=, in or is null before {_shown(right)}")
        return _comparison(_COMPARE[type(op)], part(left), part(right), left, right)

    def _is_in(self, left: ast.expr, right: ast.expr, part: Callable[..., Values]) -> Values:
        """'text' in a list column or in a text column, or a value in (constants)."""
        if isinstance(right, ast.Name):
            text, column = _of_kind("text", part(left), left), part(right)
            if isinstance(text, pa.Scalar) and _kind(column) == "text":
                return pc.match_substring(column, text.as_py())
            if isinstance(text, pa.Scalar) and _kind(column) == "list":
                holds = pa.array(lists_with(column, text.as_py()), mask=pc.is_null(column).to_numpy())
                return pa.chunked_array([holds])
        # without a comma, parentheses are no tuple
        one_of = right.elts if isinstance(right, ast.Tuple) else [right]
        if not one_of or not all(isinstance(part(one), pa.Scalar) for one in one_of):
            raise _ExpectedError(
                f"expected a list column or values such as ('lake', 'mountain'), not {_shown(right)}"
            )
        values = part(left)
        found = (_comparison(pc.equal, values, part(one), left, one) for one in one_of)
        return functools.reduce(pc.or_kleene, found)


def _comparison(
    compare: Callable[..., Values], first: Values, second: Values, left: ast.expr, right: ast.expr
) -> Values:
    kind = _kind(first)
    if kind not in ("number", "text"):
        raise _ExpectedError(f"expected a number or text, not the {kind} {_shown(left)}")
    _of_kind(kind, second, right)
    if isinstance(first, pa.StringScalar) and isinstance(second, pa.StringScalar):
        raise _quoted(left)
    if kind == "number" and not (pa.types.is_integer(first.type) and pa.types.is_integer(second.type)):
        first, second = _float(first, left), _float(second, right)
    return compare(first, second)


def _quoted(node: ast.expr) -> _ExpectedError:
    """SQL has columns in double quotes."""
    return _ExpectedError(f"expected a column, not the text {_shown(node)}; columns have no quotes")


def _kind(values: Values) -> str:
    """number, text, list, condition, or Arrow's name of another type, which a foreign index may have."""
    kind = values.type
    if pa.types.is_boolean(kind):
        return "condition"
    if pa.types.is_list(kind) and _is_text(kind.value_type):
        return "list"
    if _is_text(kind):
        return "text"
    return "number" if pa.types.is_integer(kind) or pa.types.is_floating(kind) else str(kind)


def _is_text(kind: pa.DataType) -> bool:
    return kind in (pa.string(), pa.large_string())


def _of_kind(kind: str, values: Values, node: ast.expr) -> Values:
    if _kind(values) != kind:
        raise _ExpectedError(f"expected a {kind}, not the {_kind(values)} {_shown(node)}")
    return values


def _float(values: Values, node: ast.expr) -> Values:
    return pc.cast(_of_kind("number", values, node), pa.float64(), safe=False)


def _known(values: Values) -> Values:
    """Numbers, with null instead of NaN."""
    if not pa.types.is_floating(values.type):
        return values
    return pc.if_else(pc.is_nan(values), pa.scalar(None, values.type), values)


def lists_with(lists: pa.ChunkedArray, *texts: str) -> Mask:
    """The lists (N,) of texts that contain one of these texts."""
    combined = lists.combine_chunks()
    holds = np.zeros(len(combined), np.bool_)
    at = pc.list_parent_indices(combined).filter(pc.is_in(pc.list_flatten(combined), pa.array(texts)))
    holds[at.to_numpy()] = True
    return holds


def _shown(node: ast.expr) -> str:
    try:
        return brief(ast.unparse(node), 60)
    except RecursionError:
        return "this"
