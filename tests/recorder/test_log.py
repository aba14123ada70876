"""The log: what is written comes back, from our reader and from mcap's own; a damaged one never does worse than
a clear error."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Self

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_protobuf.schema import register_schema

from common import UserError, atomic_file, files
from common.car import CAMERAS, Camera
from recorder import Log, LogError, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log import writer as writing
from recorder.topics import camera_topic
from tests.helpers.logs import START_NS, STEP_NS, plain_read, read_messages, write_log
from tests.helpers.places import Place
from tests.helpers.plain_mcap import plain_writer
from tests.helpers.udacity import jpeg


def read_everything(path: Path) -> None:
    with Log(path) as log:
        assert isinstance(log.metadata, dict)
        assert len(log.fingerprint) == 64
        for camera in CAMERAS:
            pictures = log.pictures(camera_topic(camera))
            for offset, length in zip(pictures.offset.tolist(), pictures.length.tolist(), strict=True):
                assert len(log.read(offset, length)) == length
        assert sum(1 for _ in log.vehicle_states()) + sum(1 for _ in log.commands()) <= sum(log.counts.values())


def write_one_of_each(path: Path) -> None:
    with LogWriter(path, {"source": "test", "driver": "José"}) as writer:
        writer.picture("center", 5, 1, jpeg(10))
        writer.picture("left", 5, 1, jpeg(20))
        writer.picture("right", 5, 1, jpeg(30))
        writer.vehicle(5, 1, VehicleState(steering=-0.25, throttle=0.5, brake=0.125, speed_mph=9.5))
        writer.crop(6, 1, b"\x89PNG crop")
        writer.command(7, 1, PilotCommand(predicted_steering=1.5, steering=1.0, driver=PilotCommand.PILOT))
        writer.pose(8, 1, PoseInFrame(frame_id="world"))
        writer.event(9, "off the road", "WARNING", "drive")
        writer.add_metadata("bc.run", {"sha256": "abc"})


def test_what_is_written_on_every_topic_comes_back_from_mcaps_own_reader(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_one_of_each(path)
    first = {topic: messages[0] for topic, messages in read_messages(path).items()}
    when = {topic: (message.log_time, message.sequence) for topic, (message, _) in first.items()}
    assert when == {
        "/camera/center": (5, 1),
        "/camera/left": (5, 1),
        "/camera/right": (5, 1),
        "/vehicle": (5, 1),
        "/pilot/input": (6, 1),
        "/pilot/command": (7, 1),
        "/pose": (8, 1),
        "/events": (9, 0),
    }
    reported = {topic: decoded for topic, (_, decoded) in first.items()}
    for topic, level in (("/camera/center", 10), ("/camera/left", 20), ("/camera/right", 30)):
        assert (reported[topic].data, reported[topic].format) == (jpeg(level), "jpeg")
        assert (reported[topic].timestamp.seconds, reported[topic].timestamp.nanos) == (0, 5)
    assert (reported["/pilot/input"].data, reported["/pilot/input"].format) == (b"\x89PNG crop", "png")
    state = reported["/vehicle"]
    assert (state.steering, state.throttle, state.brake, state.speed_mph) == (-0.25, 0.5, 0.125, 9.5)
    command = reported["/pilot/command"]
    assert (command.predicted_steering, command.steering, command.driver) == (1.5, 1.0, 1)
    assert reported["/pose"].frame_id == "world"
    assert (reported["/events"].message, reported["/events"].name, reported["/events"].level) == (
        "off the road",
        "drive",
        3,
    )


def test_what_is_written_comes_back_from_our_reader(tmp_path: Path, place: Place) -> None:
    path = tmp_path / "a.mcap"
    write_one_of_each(path)
    with Log(place(path)) as log:
        assert log.counts == dict.fromkeys(read_messages(path), 1)
        assert log.metadata.items() >= {"source": "test", "driver": "José"}.items()
        assert log.read_metadata("bc.run") == {"sha256": "abc"}
        assert log.read_metadata("none") == {}
        [(message, state)] = log.vehicle_states()
        assert (message.sequence, message.log_time_ns, state.speed_mph) == (1, 5, 9.5)
        [(message, command)] = log.commands()
        assert (message.log_time_ns, command.predicted_steering) == (7, 1.5)
        assert len(log.pictures("/nothing/here").offset) == 0


def test_the_file_is_what_the_design_reports(tmp_path: Path) -> None:
    """Pictures have chunks of their own, and so has all else; a chunk of pictures ends before that of its rows."""
    path = write_log(tmp_path / "a.mcap", [0.0] * 3000, lambda camera, row: bytes(1000), cameras=("center",))
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert reader.get_header().profile == "bc"
        assert {chunk.compression for chunk in summary.chunk_indexes} == {""}
        schemas = {schema.id: schema.name for schema in summary.schemas.values()}
        channels = {number: schemas[channel.schema_id] for number, channel in summary.channels.items()}
        sizes: dict[str, list[int]] = {"foxglove.CompressedImage": [], "bc.VehicleState": []}
        for chunk in summary.chunk_indexes:
            [name] = {channels[number] for number in chunk.message_index_offsets}
            sizes[name].append(chunk.uncompressed_size)
        assert set(schemas.values()) == sizes.keys()
    for name, chunk_sizes in sizes.items():
        limit = 1024 * (32 if name == "bc.VehicleState" else 256)
        assert max(chunk_sizes) < limit + 5000, name
        full = [size for size in chunk_sizes if size >= limit]
        assert len(full) > 2, name
        short = 2 if name == "bc.VehicleState" else 1 + len(sizes["bc.VehicleState"])
        assert len(chunk_sizes) - len(full) <= short, name


def test_messages_keep_the_order_of_writing_whatever_their_times(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1, 0.2, 0.3], step_ns=-STEP_NS)
    with Log(path) as log:
        reported = [(message.log_time_ns, state.steering) for message, state in log.vehicle_states()]
        assert reported == [(START_NS, 0.1), (START_NS - STEP_NS, 0.2), (START_NS - 2 * STEP_NS, 0.3)]
        assert log.pictures("/camera/left").sequence.tolist() == [0, 1, 2]


def test_ranges_of_pictures_equal_plain_reads(tmp_path: Path, place: Place) -> None:
    def noise(camera: Camera, row: int) -> bytes:
        return random.Random(f"{camera}{row}").randbytes(1 + 997 * row)  # many chunks, many lengths

    path = write_log(tmp_path / "a.mcap", [0.0] * 60, noise)
    with Log(place(path)) as log:
        for camera in CAMERAS:
            pictures = log.pictures(camera_topic(camera))
            ranges = list(zip(pictures.offset.tolist(), pictures.length.tolist(), strict=True))
            expected = [noise(camera, row) for row in range(60)]
            assert [plain_read(path, *where) for where in ranges] == expected
            assert [log.read(*where) for where in ranges] == expected
            assert pictures.log_time_ns.tolist() == [START_NS + row * STEP_NS for row in range(60)]


DATA, FORMAT, FRAME = (
    CompressedImage(data=b"the picture").SerializeToString(),
    CompressedImage(format="jpeg").SerializeToString(),
    CompressedImage(frame_id="x" * 300).SerializeToString(),
)


@pytest.mark.parametrize("fields", [[DATA, FORMAT, FRAME], [FRAME, DATA, FORMAT], [FORMAT, FRAME, DATA], [DATA]])
def test_a_picture_is_found_whatever_the_order_of_its_messages_fields(tmp_path: Path, fields: list[bytes]) -> None:
    """Other programs may serialise in another order; protobuf lets them."""
    path = tmp_path / "other.mcap"
    write_raw(path, CompressionType.NONE, b"".join(fields))
    with Log(path) as log:
        pictures = log.pictures("/camera/center")
        assert plain_read(path, int(pictures.offset[0]), int(pictures.length[0])) == b"the picture"


@pytest.mark.parametrize("data", [b"\xff" * 40, b"\x12\x7fshort", b"\x12"])
def test_a_message_that_is_no_picture_is_a_log_error(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other.mcap"
    write_raw(path, CompressionType.NONE, data)
    with Log(path) as log, pytest.raises(LogError, match=r"other\.mcap.*CompressedImage"):
        log.pictures("/camera/center")


def write_raw(path: Path, compression: CompressionType, data: bytes, time_ns: int = 1) -> None:
    """A log of one message on /camera/center, written by mcap alone."""
    with plain_writer(path, compression=compression) as writer:
        schema = register_schema(writer, CompressedImage)
        channel = writer.register_channel("/camera/center", "protobuf", schema)
        writer.add_message(channel, log_time=time_ns, publish_time=time_ns, sequence=0, data=data)


# Writing: whole or not at all


def test_a_log_appears_under_its_name_only_when_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "a.mcap"
    writer = LogWriter(path, {})
    writer.vehicle(1, 0, VehicleState())
    [part] = path.parent.iterdir()
    assert (part.name.startswith("a.mcap."), part.suffix) == (True, ".part")
    writer.close()
    assert list(path.parent.iterdir()) == [path]
    assert len(read_messages(path)["/vehicle"]) == 1


def record_and_fail(path: Path, error: BaseException, *, live: bool) -> None:
    with LogWriter(path, {}, live=live) as writer:
        writer.vehicle(1, 0, VehicleState(steering=0.5))
        raise error


def test_an_exception_discards_what_can_be_made_again(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="disk"):
        record_and_fail(tmp_path / "a.mcap", RuntimeError("disk"), live=False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [RuntimeError("lost"), KeyboardInterrupt()], ids=["error", "Ctrl-C"])
def test_an_exception_keeps_what_was_recorded_live(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(type(error)):
        record_and_fail(path, error, live=True)
    assert list(tmp_path.iterdir()) == [path]
    assert [state.steering for _, state in read_messages(path)["/vehicle"]] == [0.5]


def test_a_live_log_in_which_nothing_was_recorded_is_not_kept(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), LogWriter(tmp_path / "a.mcap", {}, live=True):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_an_existing_log_is_refused_at_once_and_stays(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1])
    before = path.read_bytes()
    with pytest.raises(UserError, match=r"a\.mcap.*--force"):
        LogWriter(path, {})
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (before, [path])
    write_log(path, [0.1, 0.2], overwrite=True)
    assert len(read_messages(path)["/vehicle"]) == 2


def test_of_two_writers_on_one_name_one_wins_and_the_other_reports_so(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writers = [LogWriter(path, {}), LogWriter(path, {})]
    for steering, writer in zip((0.1, 0.2), writers, strict=True):
        writer.vehicle(1, 0, VehicleState(steering=steering))
    writers[1].close()
    with pytest.raises(UserError, match=re.escape(f"{path} was written by another process")) as error:
        writers[0].close()
    assert f"rename {writers[0].part}, the new file, to keep it" in str(error.value)
    assert [state.steering for _, state in read_messages(path)["/vehicle"]] == [0.2]
    # what the loser made is not lost either: it is a whole log
    kept = writers[0].part.rename(tmp_path / "b.mcap")
    assert [state.steering for _, state in read_messages(kept)["/vehicle"]] == [0.1]


@pytest.mark.parametrize("live", [True, False])
def test_a_log_that_cannot_be_begun_leaves_nothing(tmp_path: Path, live: bool) -> None:
    threads = threading.active_count()
    with pytest.raises(AttributeError):
        LogWriter(tmp_path / "folder" / "a.mcap", {"no text": 5}, live=live)  # type: ignore[dict-item]
    assert (list(tmp_path.iterdir()), threading.active_count()) == ([], threads)
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"a\.mcap: cannot be written \(Not a directory|File exists\)"):
        LogWriter(tmp_path / "file" / "folder" / "a.mcap", {}, live=live)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


# Ctrl-C


class Interruption:
    """Ctrl-C before the `at`-th line of these modules that is run, wherever that is."""

    def __init__(self, at: int, *modules: ModuleType) -> None:
        self.files = {module.__file__ for module in modules}
        self.left = at

    def __enter__(self) -> Self:
        self.traced = sys.gettrace()
        sys.settrace(self._trace)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(self.traced)

    @property
    def came(self) -> bool:
        return self.left < 0

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code.co_filename not in self.files or self.came:
            return None
        if event == "line" and frame.f_code.co_name != "__exit__":  # whose first line nobody can protect
            self.left -= 1
            if self.came:
                signal.raise_signal(signal.SIGINT)
        return self._trace


def every_interruption(*modules: ModuleType) -> Iterator[Interruption]:
    for at in range(10_000):
        interruption = Interruption(at, *modules)
        yield interruption
        if not interruption.came:
            assert at > 10, "nothing was tried"
            return


@pytest.mark.parametrize("live", [True, False])
def test_wherever_ctrl_c_comes_while_a_log_is_closed_no_part_of_it_stays(tmp_path: Path, live: bool) -> None:
    """What can be made again is whole or not there; what was recorded live is whole."""
    for number, interruption in enumerate(every_interruption(writing, files)):
        path = tmp_path / f"{number}.mcap"
        with contextlib.suppress(KeyboardInterrupt), LogWriter(path, {}, live=live) as writer:
            writer.vehicle(1, 0, VehicleState(steering=0.5))
            interruption.__enter__()
        interruption.__exit__()
        if live or path.exists():
            assert len(read_messages(path)["/vehicle"]) == 1
            path.unlink()
        assert list(tmp_path.iterdir()) == [], f"line {number}"


def test_wherever_ctrl_c_comes_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    for number, interruption in enumerate(every_interruption(files)):
        path = tmp_path / f"{number}.txt"
        with contextlib.suppress(KeyboardInterrupt), atomic_file(path, overwrite=False) as part:
            part.write_text("all of it")
            interruption.__enter__()
        interruption.__exit__()
        if path.exists():
            assert path.read_text() == "all of it"
            path.unlink()
        assert list(tmp_path.iterdir()) == [], f"line {number}"


# Damage


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda path: path.write_bytes(jpeg(50)), "not an MCAP log"),
        (Path.touch, "not an MCAP log"),
        (lambda path: None, "cannot be opened"),
        (Path.mkdir, "cannot be opened"),
    ],
    ids=["of another program", "empty", "missing", "a folder"],
)
def test_a_log_that_cannot_be_read_is_a_log_error_with_its_name(
    tmp_path: Path, make: Callable[[Path], object], text: str
) -> None:
    path = tmp_path / "session.mcap"
    make(path)
    with pytest.raises(LogError, match=rf"session\.mcap: .*{text}") as caught:
        read_everything(path)
    assert "\n" not in str(caught.value)


def test_a_log_without_its_end_is_read_and_reports_so(tmp_path: Path, place: Place) -> None:
    """Every other cut: test_damage.py."""
    path = write_log(tmp_path / "a.mcap", [0.1, 0.2, 0.3])
    os.truncate(path, path.stat().st_size - 400)
    with Log(place(path)) as log:
        assert log.problem
        assert re.fullmatch(r".*a\.mcap: .*; its complete parts are read\. `bc-log recover .*", log.notice)
        assert [state.steering for _, state in log.vehicle_states()] == [0.1, 0.2, 0.3]
        assert log.counts["/vehicle"] == 3
        assert log.picture(2, "left") == b"left 2"


def test_a_log_of_which_nothing_is_there_yet_is_empty(tmp_path: Path, place: Place) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")
    with Log(place(path)) as log:
        assert (log.counts, log.metadata, log.frames().num_rows, log.lost) == ({}, {}, 0, [])
        assert "unfinished" in log.notice


@pytest.mark.parametrize("compression", CompressionType)
def test_compressed_logs_are_read(tmp_path: Path, place: Place, compression: CompressionType) -> None:
    path = tmp_path / "other.mcap"
    write_raw(path, compression, DATA)
    with Log(place(path)) as log:
        assert (log.problem, log.notice, log.lost) == ("", "", [])
        assert log.picture(0) == b"the picture"


def test_a_time_that_no_table_can_hold_is_a_log_error(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_raw(path, CompressionType.NONE, DATA, 2**64 - 1)
    with Log(path) as log, pytest.raises(LogError, match=r"a\.mcap.*18446744073709551615"):
        log.pictures("/camera/center")


# Fingerprint


def fingerprint(path: Path) -> str:
    with Log(path) as log:
        return log.fingerprint


def test_the_fingerprint_changes_with_any_byte_of_any_picture(tmp_path: Path) -> None:
    def pictures(changed: tuple[Camera, int] | None) -> Callable[[Camera, int], bytes]:
        return lambda camera, row: bytes(20_000) + bytes([(camera, row) == changed])

    original = fingerprint(write_log(tmp_path / "original.mcap", [0.0] * 10, pictures(None)))
    others = {
        fingerprint(write_log(tmp_path / f"{camera}{row}.mcap", [0.0] * 10, pictures((camera, row))))
        for camera in CAMERAS
        for row in (0, 5, 9)
    }
    assert len(others | {original}) == 10


# Finished logs of other programs, whose summary leaves out what the specification lets them
