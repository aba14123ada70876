"""Recognises messages that are pictures, and finds the picture in a serialised foxglove.CompressedImage."""

from __future__ import annotations

from typing import Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from recorder.topics import COMPRESSED_IMAGE

_DATA_FIELD: Final = 2


def is_protobuf_channel(schema: Schema | None, channel: Channel, name: str) -> bool:
    """True if a channel has messages of the schema `name` in Protobuf; other programs may use JSON."""
    return schema is not None and (schema.name, channel.message_encoding) == (name, MessageEncoding.Protobuf)


def is_image_channel(schema: Schema | None, channel: Channel) -> bool:
    """True if a channel's messages are CompressedImages in Protobuf."""
    return is_protobuf_channel(schema, channel, COMPRESSED_IMAGE.name)


def image_data(data: bytes | memoryview, offset: int, length: int) -> tuple[int, int]:
    """Offset and length of the picture in the message of `length` bytes at `offset` of `data`; (-1, 0) if the
    message is damaged.

    Walks the message's fields in any order (https://protobuf.dev/programming-guides/encoding/).
    """
    position, end = offset, offset + length
    while position < end:
        # most numbers have one to three bytes: a call for each would take half of the time
        tag, position = (data[position], position + 1) if data[position] < 0x80 else _varint(data, position, end)
        if position < end and (first := data[position]) < 0x80:
            size, position = first, position + 1
        elif position + 1 < end and (second := data[position + 1]) < 0x80:
            size, position = first & 0x7F | second << 7, position + 2
        elif position + 2 < end and (third := data[position + 2]) < 0x80:
            size, position = first & 0x7F | (second & 0x7F) << 7 | third << 14, position + 3
        else:
            size, position = _varint(data, position, end)
        if tag & 7 != 2 or size < 0 or position + size > end:  # all its fields are length-delimited
            return -1, 0
        if tag >> 3 == _DATA_FIELD:
            return position, size
        position += size
    return end, 0  # Protobuf leaves an empty field out


def _varint(data: bytes | memoryview, position: int, end: int) -> tuple[int, int]:
    """A base-128 varint and the position after it; (-1, end) if it is cut off or longer than ten bytes."""
    value, shift = 0, 0
    for i in range(position, min(end, position + 10)):
        value |= (data[i] & 0x7F) << shift
        if data[i] < 0x80:
            return value, i + 1
        shift += 7
    return -1, end
