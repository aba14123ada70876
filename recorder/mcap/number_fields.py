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
_VARINT_BYTES: Final = 5  # at most; the seconds of a time have five until the year 3058
_LAST_NUMBER: Final = 15  # of the fields whose tag is one byte
_PADDING: Final = bytes(16)  # a cut-off field of the last message ends in it
_VARINT, _EIGHT_BYTES, _LENGTH_FIRST = 0, 1, 2  # wire types

Places = NDArray[np.int64]
Mask = NDArray[np.bool_]


def decode_numbers(
    data: bytes, starts: Places, ends: Places, kind: type[Message], names: Sequence[str]
) -> NDArray[np.float64]:
    """The fields `names` of N serialised messages of a type: an array (len(names), N). Message i is
    data[starts[i]:ends[i]]. A missing `optional` field is NaN. A field of a field is named "pose.position.x".

    Usual messages have each field at most once, in the order of their numbers
    (https://protobuf.dev/programming-guides/encoding/), counts below 128, and short texts. They are decoded
    together, other messages by Protobuf. Raises DecodeError as Protobuf does.
    """
    values = np.zeros((len(names), len(starts)))
    fields: list[Any] = list(kind.DESCRIPTOR.fields)
    lacking = {field.name for field in fields if field.has_presence and field.message_type is None}
    values[[name in lacking for name in names]] = np.nan
    together = _Together(data, names, values)
    is_done = together.decode(kind.DESCRIPTOR, np.arange(len(starts)), starts, ends)
    for number in np.flatnonzero(~is_done).tolist():
        message = kind.FromString(data[starts[number] : ends[number]])
        for row, name in zip(values, names, strict=True):
            is_missing = name in lacking and not message.HasField(name)
            row[number] = np.nan if is_missing else attrgetter(name)(message)
    return values


def known_values(numbers: NDArray[np.float64], count: int) -> NDArray[np.int8]:
    """The values (N,) of an enum with `count` of them: 0, unknown, for those of a later version."""
    return np.where((numbers >= 0) & (numbers < count), numbers, 0).astype(np.int8)


class _Together:
    """Decodes the same field of many messages at once."""

    def __init__(self, data: bytes, names: Sequence[str], values: NDArray[np.float64]) -> None:
        self._bytes = np.frombuffer(data + _PADDING, np.uint8)
        # a view of the double that begins at each byte
        self._doubles = np.ndarray(len(self._bytes) - 7, "<f8", self._bytes, strides=(1,))
        self._rows = dict(zip(names, values, strict=True))

    def decode(self, kind: Any, numbers: Places, starts: Places, ends: Places, prefix: str = "") -> Mask:
        """Write the fields of messages `numbers` (N,), from `starts` to `ends`, to their values. Returns a mask
        (N,) of the usual messages, which are done."""
        at, is_usual = starts.copy(), np.ones(len(starts), np.bool_)
        for field in sorted(kind.fields, key=attrgetter("number")):
            wire = _wire_type(field)
            if wire is None:
                continue
            has_field = (self._bytes[at] == (field.number << 3 | wire)) & (at < ends)
            (found,) = np.nonzero(has_field)
            if len(found) == 0:
                continue
            begin, row = at[found] + 1, self._rows.get(prefix + field.name)
            if wire == _EIGHT_BYTES:
                at[found] += _DOUBLE_BYTES
                if row is not None:
                    row[numbers[found]] = self._doubles[begin]
            elif wire == _VARINT:
                size = self._varint_bytes(begin)
                at[found] = begin + size
                is_usual[found] &= (size > 0) if row is None else (size == 1)
                if row is not None:
                    row[numbers[found]] = self._bytes[begin]
            else:
                size = self._bytes[begin].astype(np.int64)
                until = np.minimum(begin + 1 + size, ends[found])
                is_usual[found] &= (size < 0x80) & (until == begin + 1 + size)
                at[found] = until
                if field.message_type is None:
                    is_usual[found] &= self._are_equal_ascii(begin, size)
                else:
                    inside = f"{prefix}{field.name}."
                    is_usual[found] &= self.decode(field.message_type, numbers[found], begin + 1, until, inside)
        is_usual &= at == ends
        return is_usual

    def _varint_bytes(self, begin: Places) -> Places:
        """The length of each varint; 0 for a long one."""
        if (self._bytes[begin] < 0x80).all():
            return np.ones(len(begin), np.int64)
        window = np.minimum(begin[:, None] + np.arange(_VARINT_BYTES), len(self._bytes) - 1)
        is_last = self._bytes[window] < 0x80
        return np.where(is_last.any(axis=1), is_last.argmax(axis=1) + 1, 0)

    def _are_equal_ascii(self, begin: Places, size: Places) -> Mask:
        """True for each text that is equal to the first one, which is in ASCII. Protobuf decodes other texts, and
        refuses wrong UTF-8."""
        first = self._bytes[begin[0] : begin[0] + 1 + size[0]]  # with its length
        window = np.minimum(begin[:, None] + np.arange(len(first)), len(self._bytes) - 1)
        are_equal: Mask = (self._bytes[window] == first).all(axis=1) & (first < 0x80).all()
        return are_equal


def _wire_type(field: Any) -> int | None:
    """The wire type of a field that is decoded together; None: left to Protobuf."""
    is_repeated = isinstance(field.default_value, list)  # `field.is_repeated` is not in Protobuf 5
    if is_repeated or field.number > _LAST_NUMBER:
        return None
    if field.type == field.TYPE_DOUBLE:
        return _EIGHT_BYTES
    if field.type in (field.TYPE_ENUM, field.TYPE_UINT32, field.TYPE_INT32, field.TYPE_INT64):
        return _VARINT
    return _LENGTH_FIRST if field.type in (field.TYPE_STRING, field.TYPE_MESSAGE) else None
