"""Decodes the numbers of many Protobuf messages at once: doubles, counts and values of an enum."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from google.protobuf.message import Message

_DOUBLE_BYTES: Final = 1 + 8  # a tag, and eight bytes in little-endian order
_SMALL_BYTES: Final = 1 + 1  # a tag, and a number below 128
_LAST_NUMBER: Final = 15  # of the fields whose tag is one byte


def decode_numbers(
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    kind: type[Message],
    names: Sequence[str],
) -> NDArray[np.float64]:
    """The fields `names` of N serialised messages of a type: an array (len(names), N). Message i is
    data[starts[i]:ends[i]]. A missing `optional` field is NaN.

    Usual messages have each field at most once, in the order of their numbers
    (https://protobuf.dev/programming-guides/encoding/), and counts below 128. They are decoded together. Protobuf
    decodes other messages, and all messages of types with fields of other kinds. Raises DecodeError as Protobuf
    does.
    """
    values = np.zeros((len(names), len(starts)))
    is_done = np.zeros(len(starts), np.bool_)
    fields: list[Any] = sorted(kind.DESCRIPTOR.fields, key=attrgetter("number"))
    if all(map(_is_plain, fields)):
        # the padding lets a cut-off field of the last message end beyond it
        padded = np.frombuffer(data + bytes(2 * _DOUBLE_BYTES), np.uint8)
        doubles = np.ndarray(len(padded) - _DOUBLE_BYTES, "<f8", padded, strides=(1,))  # at each byte
        at = starts.copy()
        for field in fields:
            is_double = field.type == field.TYPE_DOUBLE
            is_present = (padded[at] == (field.number << 3 | is_double)) & (at < ends)  # wire type 1: eight bytes
            if not is_double:
                is_present &= padded[at + 1] < 0x80
            present = slice(None) if is_present.all() else np.flatnonzero(is_present)
            if field.name in names:
                row = values[names.index(field.name)]
                if field.has_presence:
                    row[:] = np.nan
                if is_double:
                    row[present] = doubles[at[present] + 1]
                else:
                    row[present] = padded[at[present] + 1]
            at[present] += _DOUBLE_BYTES if is_double else _SMALL_BYTES
        is_done = at == ends
    lacking = {field.name for field in fields if field.has_presence and field.message_type is None}
    for number in np.flatnonzero(~is_done).tolist():
        message = kind.FromString(data[starts[number] : ends[number]])
        for row, name in zip(values, names, strict=True):
            is_missing = name in lacking and not message.HasField(name)
            row[number] = np.nan if is_missing else attrgetter(name)(message)
    return values


def _is_plain(field: Any) -> bool:
    is_number = field.type in (field.TYPE_DOUBLE, field.TYPE_ENUM, field.TYPE_UINT32)
    is_repeated = isinstance(field.default_value, list)  # `field.is_repeated` is not in Protobuf 5
    return is_number and not is_repeated and field.number <= _LAST_NUMBER
