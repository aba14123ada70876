"""Channels of other logs in the log that their messages are copied to."""

from __future__ import annotations

from mcap.records import Channel, Schema
from mcap.writer import Writer


class CopiedChannels:
    """Registers each channel once: logs that are merged share those that are alike."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._by_id: dict[int, tuple[Channel, int]] = {}
        self._channels: dict[tuple[object, ...], int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def number_of(self, schema: Schema | None, channel: Channel) -> int:
        """The number of a channel of another log in this one."""
        entry = self._by_id.get(id(channel))
        if entry is None:
            # keeping the channel keeps its id from being used again
            entry = self._by_id[id(channel)] = (channel, self._register(schema, channel))
        return entry[1]

    def _register(self, schema: Schema | None, channel: Channel) -> int:
        metadata = dict(channel.metadata)
        number = self._register_schema(schema)
        key = (channel.topic, channel.message_encoding, number, *sorted(metadata.items()))
        if key not in self._channels:
            self._channels[key] = self._writer.register_channel(
                channel.topic, channel.message_encoding, number, metadata
            )
        return self._channels[key]

    def _register_schema(self, schema: Schema | None) -> int:
        if schema is None:
            return 0  # in MCAP: no schema
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(*key)
        return self._schemas[key]
