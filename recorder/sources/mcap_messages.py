"""Reads other programs' messages: their decoders, the number in a field, the picture.

Definitions and messages are untrusted: no decoder here generates and runs code from a definition.
"""

from __future__ import annotations

import array
import base64
import binascii
import contextlib
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Final, TypeGuard

from google.protobuf.message import Message as ProtobufMessage
from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders

from common.errors import brief
from common.versions import install_line
from recorder.errors import RecordingError

MAX_DEFINITION_BYTES: Final = 1 << 16
"""The longest definition of a type, with its parts. A car's commands have some hundred bytes. Reading 3 MB takes
minutes."""

_PICTURE_TYPE = re.compile(r"(foxglove|foxglove_msgs|sensor_msgs)[./](msg/)?CompressedImage")

Decoder = Callable[[bytes], object]


class FieldError(Exception):
    """A message lacks a field or a picture. `is_final`: all messages of its type lack it."""

    is_final = False


def is_picture_type(name: str) -> bool:
    return _PICTURE_TYPE.fullmatch(name) is not None


def decoder_for(schema: Schema | None, channel: Channel) -> Decoder:
    """The decoder of a channel's messages, which may raise anything. Raises RecordingError if there is none."""
    encoding = channel.message_encoding
    if schema is not None and len(schema.data) > MAX_DEFINITION_BYTES:
        raise RecordingError(
            f"{brief(channel.topic)}: the definition of its type has {len(schema.data):,} bytes;"
            f" expected at most {MAX_DEFINITION_BYTES:,}"
        )
    if encoding == "json":
        return json.loads
    if encoding == "protobuf":
        find = ProtobufDecoders().decoder_for
    elif encoding == "cdr":
        try:
            from mcap_ros2.decoder import DecoderFactory as RosDecoders
        except ImportError:
            raise RecordingError(f"{channel.topic}: {needs_ros()}") from None
        find = RosDecoders().decoder_for
    else:
        raise RecordingError(
            f"{brief(channel.topic)}: its messages are encoded as {brief(encoding)};"
            " protobuf, JSON and the CDR of ROS 2 can be read"
        )
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # mcap-ros2-support prints errors before it raises them
            decoder: Decoder | None = find(encoding, schema)
    except Exception as error:  # an invalid definition may raise anything
        raise RecordingError(
            f"{brief(channel.topic)}: the definition of its type cannot be read ({brief(str(error))})"
        ) from None
    if decoder is None:
        kind = "none" if schema is None else brief(schema.encoding)
        raise RecordingError(f"{brief(channel.topic)}: no definition of its type that can be read (it is {kind})")
    return decoder


def number_in(message: object, field: str) -> float:
    """The finite number in `field`, such as `drive.steering_angle` or `axes.0`.

    Raises FieldError, which names the existing fields.
    """
    names = field.split(".") if field else []
    try:
        value, parents = message, ""
        for name in names:
            value = _child(value, name, parents)
            parents = f"{parents}{name}."
        if not isinstance(value, int | float) or isinstance(value, bool):
            has = f"; it has {_listed(fields)}" if (fields := _names(value)) else ""
            raise FieldError(f"{brief(field) or 'the message'} is not a number but {_kind(value)}{has}")
    except FieldError as error:
        is_typed = isinstance(message, ProtobufMessage | SimpleNamespace)
        error.is_final = is_typed and not any(name.isdecimal() for name in names)  # lists may be longer elsewhere
        raise
    try:
        number = float(value)
    except OverflowError:  # a whole number of over 308 digits
        number = math.inf
    if not math.isfinite(number):
        raise FieldError(f"{brief(field)} is not a finite number")
    return number


def picture_in(message: object) -> bytes:
    """The bytes of a CompressedImage's picture; in JSON, base64 or a list of numbers. Raises FieldError without
    one."""
    data = _child(message, "data", "")
    try:
        if isinstance(data, str):
            return base64.b64decode(data, validate=True)
        if isinstance(data, bytes | bytearray | memoryview | list):
            return bytes(data)
    except (binascii.Error, TypeError, ValueError):
        pass
    raise FieldError("data is not a picture")


def needs_ros() -> str:
    """The error if the packages for ROS 2 messages are missing."""
    return f"ROS 2 messages need two packages more: `{install_line('ros')}` brings them"


def _child(value: object, name: str, parents: str) -> object:
    if isinstance(value, Mapping):
        if name in value:
            return value[name]
    elif isinstance(value, ProtobufMessage | SimpleNamespace):
        if name in _names(value):
            return getattr(value, name)
    elif _is_list(value) and name.isdecimal() and len(name) < 10 and int(name) < len(value):
        return value[int(name)]
    where = brief(parents.removesuffix(".")) or "the message"
    raise FieldError(f"{where} has no {brief(name)}; it has {_listed(_names(value))}")


def _names(value: object) -> list[str]:
    """The fields of a message, or the positions in a list."""
    if isinstance(value, Mapping):
        return [str(name) for name in value]
    if isinstance(value, ProtobufMessage):
        return [field.name for field in value.DESCRIPTOR.fields]
    if isinstance(value, SimpleNamespace):  # what mcap-ros2-support makes of a message
        return list(getattr(value, "__slots__", ()))
    if _is_list(value):
        return [str(position) for position in range(min(len(value), 100))]
    return []


def _is_list(value: object) -> TypeGuard[Sequence[object]]:
    return isinstance(value, Sequence | array.array) and not isinstance(value, str)


def _kind(value: object) -> str:
    if isinstance(value, str | bytes | bool):
        return {str: "a text", bytes: "bytes", bool: "true or false"}[type(value)]
    return "a list" if _is_list(value) else "nothing" if value is None else "a message"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(brief(name) for name in names[:40]) or "no fields"
