"""The numbers of many Protobuf messages at once, for messages of double fields only."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from google.protobuf.message import Message

_FIELD_BYTES: Final = 1 + 8  # a tag, and a little-endian double
_WIRE_TYPE: Final = 1  # of eight bytes
_LAST_NUMBER: Final = 15  # of the fields whose tag is one byte


def decode_doubles(contents: Sequence[bytes], kind: type[Message], names: Sequence[str]) -> NDArray[np.float64]:
    """The fields `names` of N serialised messages of a type: an array (len(names), N).

    What writers write, each field at most once and in the order of their numbers
    (https://protobuf.dev/programming-guides/encoding/), is taken from all messages at once; any other message, and
    all of a type that has fields of other kinds, are decoded by Protobuf. Raises DecodeError as that does.
    """
    found = np.zeros((len(names), len(contents)))
    is_done = np.zeros(len(contents), np.bool_)
    fields: list[Any] = sorted(kind.DESCRIPTOR.fields, key=attrgetter("number"))
    is_of_doubles = all(
        field.type == field.TYPE_DOUBLE and not field.is_repeated and field.number <= _LAST_NUMBER
        for field in fields
    )
    if is_of_doubles and len(contents):
        # a field that is cut off ends beyond its message: within the last one's, too
        data = np.frombuffer(b"".join(contents) + bytes(2 * _FIELD_BYTES), np.uint8)
        end = np.cumsum([len(content) for content in contents])
        at = np.concatenate([[0], end[:-1]])
        for field in fields:
            (here,) = np.nonzero((data[at] == (field.number << 3 | _WIRE_TYPE)) & (at < end))
            if field.name in names:
                values = data[at[here, None] + np.arange(1, _FIELD_BYTES)].view("<f8")[:, 0]
                found[names.index(field.name), here] = values
            at[here] += _FIELD_BYTES
        is_done = at == end
    for number in np.flatnonzero(~is_done).tolist():
        message = kind.FromString(contents[number])
        found[:, number] = [attrgetter(name)(message) for name in names]
    return found
