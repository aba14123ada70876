"""One log in Rerun and in Foxglove: each gets it as it is, and nothing of this toolkit is imported.

    python examples/foxglove_and_rerun.py run.mcap [run.rrd]

Rerun's own reader takes the file (into run.rrd, where that is given, and not into a window). Foxglove opens it
(Open local file), too; here it is played, again and again, to each viewer (Open connection, ws://localhost:8765).
"""

import sys
import time
from pathlib import Path

import foxglove
import rerun as rr
from mcap.reader import make_reader


def show_in_rerun(log: Path, rrd: str | None = None) -> None:
    with rr.RecordingStream("one log") as recording:
        if rrd is None:
            recording.spawn()
        else:
            recording.save(rrd)
        recording.log_file_from_path(log)


def channels_of(log: Path) -> dict[str, foxglove.Channel]:
    """The log's topics, as they are advertised to a viewer."""
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary is None:
        sys.exit(f"{log}: is not finished; `bc-log recover` makes a log of it")
    channels = {}
    for channel in summary.channels.values():
        of = summary.schemas[channel.schema_id]
        schema = foxglove.Schema(name=of.name, encoding=of.encoding, data=of.data)
        kind = channel.message_encoding
        channels[channel.topic] = foxglove.Channel(channel.topic, schema=schema, message_encoding=kind)
    return channels


def play_to_foxglove(log: Path, channels: dict[str, foxglove.Channel], speed: float = 1.0) -> None:
    """Send the log's messages, byte for byte, in its own time or faster."""
    begun_s, first_ns = time.monotonic(), None
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            first_ns = message.log_time if first_ns is None else first_ns
            due_s = begun_s + (message.log_time - first_ns) / 1e9 / speed
            time.sleep(max(0.0, due_s - time.monotonic()))
            channels[channel.topic].log(message.data, log_time=message.log_time)


if __name__ == "__main__":
    path = Path(sys.argv[1])
    show_in_rerun(path, *sys.argv[2:])
    channels = channels_of(path)
    server = foxglove.start_server()
    print(f"{', '.join(sorted(channels))} at ws://localhost:{server.port}; Ctrl-C ends it", flush=True)
    while True:
        play_to_foxglove(path, channels)
