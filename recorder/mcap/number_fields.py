"""Decodes the numbers of Protobuf messages: doubles, counts and values of an enum."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from google.protobuf.message import Message


def decode_numbers(
    data: bytes, starts: NDArray[np.int64], ends: NDArray[np.int64], kind: type[Message], names: Sequence[str]
) -> NDArray[np.float64]:
    """The fields `names` of N serialised messages of a type: an array (len(names), N). Message i is
    data[starts[i]:ends[i]]. A missing `optional` field is NaN. A field of a field is named "pose.position.x".
    Raises DecodeError as Protobuf does."""
    fields: list[Any] = list(kind.DESCRIPTOR.fields)
    lacking = {field.name for field in fields if field.has_presence and field.message_type is None}
    places = zip(starts.tolist(), ends.tolist(), strict=True)
    messages = [kind.FromString(data[start:end]) for start, end in places]
    values = np.empty((len(names), len(messages)))
    for row, name in zip(values, names, strict=True):
        row[:] = list(map(attrgetter(name), messages))
        if name in lacking:
            row[[not message.HasField(name) for message in messages]] = np.nan
    return values


def known_values(numbers: NDArray[np.float64], count: int) -> NDArray[np.int8]:
    """The values (N,) of an enum with `count` of them: 0, unknown, for those of a later version."""
    return np.where((numbers >= 0) & (numbers < count), numbers, 0).astype(np.int8)
