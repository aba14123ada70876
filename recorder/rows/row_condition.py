"""Conditions on the rows of a log, such as "speed_mph < 2 and throttle > 0": comparisons joined by and, or."""

from __future__ import annotations

import ast
import functools
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.errors import UsageError
from recorder.rows.row_quality import States

COLUMNS: Final = ("row", "time_s", "steering", "throttle", "brake", "speed_mph")
"""The columns to compare; time_s counts from the log's first row."""

Mask = NDArray[np.bool_]

_COMPARE: Final[Mapping[type[ast.cmpop], Callable[[Any, Any], Any]]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_SINGLE_EQUALS: Final = re.compile(r"(?<![<>=!])=(?!=)")
_AND_OR: Final = re.compile(r"\b(and|or)\b", re.IGNORECASE)
_MAX_CHARACTERS: Final = 500


def rows_where(states: States, condition: str) -> Mask:
    """The rows (N,) that meet a condition. No comparison with an unknown number holds. The text is parsed as a
    Python expression, but never run. Raises UsageError for anything else."""
    if len(condition) > _MAX_CHARACTERS:
        raise UsageError(f"--where: {len(condition):,} characters; at most {_MAX_CHARACTERS} are allowed")
    text = _AND_OR.sub(lambda word: word[0].lower(), _SINGLE_EQUALS.sub("==", condition.strip()))
    since_s = (states.time_ns - states.time_ns[:1]) / 1e9
    columns = {name: since_s if name == "time_s" else getattr(states, name) for name in COLUMNS}
    try:
        return np.broadcast_to(_mask(ast.parse(text, mode="eval").body, columns), states.row.shape)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        expected = error.args[0] if isinstance(error, _ExpectedError) else "comparisons joined by and, or"
        raise UsageError(f"--where {condition!r}: expected {expected}; columns are {', '.join(COLUMNS)}") from None


class _ExpectedError(ValueError):
    """A part of a condition is not of the form that its text names."""


def _mask(node: ast.expr, columns: Mapping[str, NDArray[Any]]) -> Mask:
    match node:
        case ast.BoolOp(op=op, values=values):
            join = np.logical_and if isinstance(op, ast.And) else np.logical_or
            return functools.reduce(join, (_mask(value, columns) for value in values))
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARE:
            first, second = _value(left, columns), _value(right, columns)
            holds: Mask = np.asarray(_COMPARE[type(op)](first, second) & ~np.isnan(first) & ~np.isnan(second))
            return holds
    raise _ExpectedError(f"a comparison (<, <=, >, >=, =, !=), not {ast.unparse(node)}")


def _value(node: ast.expr, columns: Mapping[str, NDArray[Any]]) -> NDArray[Any] | float:
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_value(operand, columns)
        case ast.Name(id=name) if name in columns:
            return columns[name]
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
    raise _ExpectedError(f"a number or a column, not {ast.unparse(node)}")
