"""Reads run.mcap with `mcap` and `mcap-protobuf-support`, without this toolkit."""

from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

states: dict[int, Any] = {}
pictures: dict[int, bytes] = {}
with Path("run.mcap").open("rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    about = {record.name: record.metadata for record in reader.iter_metadata()}
    messages = reader.iter_decoded_messages(["/vehicle", "/camera/center"], log_time_order=False)
    for _, channel, message, decoded in messages:
        if channel.topic == "/vehicle":
            states[message.sequence] = decoded
        else:
            pictures[message.sequence] = decoded.data  # a JPEG

print(about["bc.session"]["source"], len(states), "rows", len(pictures), "pictures")
for row, state in states.items():
    print(row, state.steering, state.throttle, state.brake, state.speed_mph, len(pictures.get(row, b"")))
