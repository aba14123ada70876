"""Conditions on the rows of a log, such as "speed_mph < 2 and throttle > 0": comparisons joined by and, or."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.errors import UsageError
from recorder.rows.row_quality import States

COLUMNS: Final = ("row", "time_s", "steering", "throttle", "brake", "speed_mph")
"""What can be compared; time_s is counted from the log's first row."""

Mask = NDArray[np.bool_]

_COMPARE: Final[Mapping[str, Callable[[Any, Any], Any]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "==": operator.eq,
    "!=": operator.ne,
}
_NUMBER: Final = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_TOKEN: Final = re.compile(rf"{_NUMBER.pattern}|[A-Za-z_]\w*|[<>=!]=|\S", re.ASCII)
_MAX_CHARACTERS: Final = 500
_MAX_PARENTHESES: Final = 50


def rows_where(states: States, condition: str) -> Mask:
    """The rows (N,) for which a condition holds; no comparison with an unknown number does. Raises UsageError,
    with what was expected where, for any other text."""
    if len(condition) > _MAX_CHARACTERS:
        raise UsageError(f"--where: {len(condition):,} characters; at most {_MAX_CHARACTERS} are taken")
    return _Parser(states, condition).parsed()


class _Parser:
    def __init__(self, states: States, text: str) -> None:
        since_s = (states.time_ns - states.time_ns[:1]) / 1e9
        self._columns = {name: since_s if name == "time_s" else getattr(states, name) for name in COLUMNS}
        self._shape = states.row.shape
        self._depth = 0
        self._text = text
        self._tokens: list[str] = _TOKEN.findall(text)
        self._at = 0

    def parsed(self) -> Mask:
        mask = self._any()
        if self._at < len(self._tokens):
            raise self._expected("and, or, or the end")
        return mask

    def _any(self) -> Mask:
        mask = self._all()
        while self._took("or"):
            mask = mask | self._all()
        return mask

    def _all(self) -> Mask:
        mask = self._one()
        while self._took("and"):
            mask = mask & self._one()
        return mask

    def _one(self) -> Mask:
        if self._took("("):
            self._depth += 1
            if self._depth > _MAX_PARENTHESES:
                raise UsageError(f"--where: at most {_MAX_PARENTHESES} parentheses are taken")
            mask = self._any()
            if not self._took(")"):
                raise self._expected("and, or, or )")
            return mask
        left = self._value()
        compare = _COMPARE.get(self._next())
        if compare is None:
            raise self._expected("a comparison (<, <=, >, >=, =, !=)")
        self._at += 1
        right = self._value()
        holds: Mask = compare(left, right) & ~np.isnan(left) & ~np.isnan(right)
        return np.broadcast_to(holds, self._shape)

    def _value(self) -> NDArray[Any] | float:
        sign = -1.0 if self._took("-") else 1.0
        token = self._next()
        if token in self._columns:
            self._at += 1
            return self._columns[token] * sign
        if not _NUMBER.fullmatch(token):
            raise self._expected(f"a number, or one of {', '.join(COLUMNS)}")
        self._at += 1
        return float(token) * sign

    def _next(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _took(self, token: str) -> bool:
        is_it = self._next().lower() == token
        self._at += is_it
        return is_it

    def _expected(self, what: str) -> UsageError:
        where = f"before {self._next()!r}" if self._next() else "at its end"
        return UsageError(f"--where {self._text!r}: {what} was expected {where}")
