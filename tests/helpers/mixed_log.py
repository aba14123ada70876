"""Logs as earlier versions wrote them: every chunk holds a little of everything."""

from __future__ import annotations

from pathlib import Path

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_protobuf.schema import register_schema

from plain_mcap import contents
from recorder.bc_pb2 import PilotCommand, Prediction, VehicleState

_TYPES = {
    kind.DESCRIPTOR.full_name: kind
    for kind in (CompressedImage, LogMessage, PoseInFrame, PilotCommand, Prediction, VehicleState)
}


def mixed_log(of: Path, to: Path, chunk_bytes: int = 1024) -> Path:
    """The messages and metadata of the log `of`, by mcap's own writer and as earlier versions wrote them: in the
    order of their times, pictures first."""
    found = contents(of)
    messages = sorted(found.messages, key=lambda m: (m.log_time, m.schema != "foxglove.CompressedImage"))
    with to.open("wb") as stream:
        writer = McapWriter(
            stream, chunk_size=chunk_bytes, compression=CompressionType.NONE, enable_data_crcs=True
        )
        writer.start(profile="bc", library="behavioural-cloning-toolkit 0.1.0")
        for name, values in found.metadata:
            if name not in ("bc.quality", "bc.rewritten"):
                writer.add_metadata(name, values)
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for message in messages:
            if message.schema not in schemas:
                schemas[message.schema] = register_schema(writer, _TYPES[message.schema])
            if message.topic not in channels:
                channels[message.topic] = writer.register_channel(
                    message.topic, "protobuf", schemas[message.schema]
                )
            writer.add_message(
                channels[message.topic], message.log_time, message.data, message.publish_time, message.sequence
            )
        for name, values in found.metadata:
            if name == "bc.quality":
                writer.add_metadata(name, {key: values[key] for key in values if key != "first_picture_px"})
        writer.finish()  # type: ignore[no-untyped-call]
    return to
