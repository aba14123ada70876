"""The messages of a log with many small chunks are those that MCAP's own reader finds, with any content."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from recorder import Log
from recorder.mcap import message_index

like_a_message = st.builds(
    lambda length, rest: b"\x05" + struct.pack("<Q", length) + rest, st.integers(0, 300), st.binary(max_size=40)
)
contents = st.one_of(st.binary(max_size=60), like_a_message)
all_contents = st.lists(st.tuples(st.sampled_from("ab"), contents), max_size=60)


def mcap(messages: list[tuple[str, bytes]], chunk_bytes: int) -> bytes:
    """A file of MCAP's own writer, which registers a channel in the chunk of its first message."""
    file, channels = io.BytesIO(), dict[str, int]()
    writer = Writer(file, chunk_size=chunk_bytes)
    writer.start()
    for number, (topic, content) in enumerate(messages):
        if topic not in channels:
            channels[topic] = writer.register_channel(f"/{topic}", "raw", 0)
        writer.add_message(channels[topic], log_time=number, publish_time=0, sequence=number, data=content)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("log") / "log.mcap"


@given(all_contents, st.sampled_from([1, 100, 1000]), st.sampled_from([1, 1000]))
def test_the_messages_are_those_of_mcaps_reader(
    path: Path, messages: list[tuple[str, bytes]], chunk_bytes: int, at_once: int
) -> None:
    file = io.BytesIO(mcap(messages, chunk_bytes))
    path.write_bytes(file.getvalue())
    with pytest.MonkeyPatch.context() as patch, Log(path) as log:
        patch.setattr(message_index, "_AT_ONCE", at_once)  # groups with and without channels in them
        for topic in ("/a", "/b"):
            file.seek(0)
            expected = [
                (message.sequence, message.log_time, message.data)
                for _, _, message in make_reader(file).iter_messages(topics=topic)
            ]
            found = [(place.sequence, place.log_time_ns, content) for place, content in log.contents(topic)]
            assert found == expected
