"""Frames of a video in a log's messages become pictures: each its own message's, or none."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from rosbags.rosbag2 import StoragePlugin

from common.car import CAMERAS, Camera
from dataset.frames.frame_flags import ImageFindings
from dataset.frames.image_check_cache import check_all_images, check_images, read_image_check
from recorder import Log, LogWriter, RecordingError
from recorder.bc_pb2 import VehicleState
from recorder.pictures.image_check import ImageCheck
from recorder.pictures.picture_size import MAX_PIXELS, width_and_height
from recorder.sources.compressed_video import VideoDecoder, is_video_type, video_in
from recorder.sources.import_recording import import_recording
from recorder.sources.mcap_messages import FieldError, decoder_for
from recorder.sources.ros2_bag import SqliteFile
from recorder.sources.settings import ImportSettings
from recorder.upkeep.check import check
from tests.helpers.logs import START_NS, STEP_NS, read_messages
from tests.helpers.other_logs import VIDEO, WHEEL
from tests.helpers.plain_mcap import plain_writer
from tests.helpers.udacity import jpeg
from tests.helpers.videos import (
    FOXGLOVE_TYPE,
    GOP,
    PACKET_TYPE,
    ROS_VIDEO_TOPICS,
    VIDEO_TOPICS,
    encoded,
    number_of,
    write_video_bag,
    write_video_log,
)

FRAMES = 24
ENCODERS = [  # encoder, its options for a stream without delay, format in messages
    ("libx264", {}, "h264"),
    ("libx264", {"preset": "ultrafast", "tune": "zerolatency"}, "libx264;yuv420p;bgr8;bgr8"),
    ("libx265", {"x265-params": f"bframes=0:keyint={GOP}:repeat-headers=1:log-level=none"}, "hevc_nvenc"),
    ("libvpx-vp9", {"lag-in-frames": "0", "deadline": "realtime"}, "vp9"),
    ("libsvtav1", {"preset": "12", "crf": "10", "svtav1-params": "pred-struct=1:lookahead=0:lp=1"}, "av1"),
]


def numbers(packets: Iterable[bytes], video_format: str = "h264") -> list[int | None]:
    """The number of the frame that each message's picture shows."""
    decoder = VideoDecoder(video_format)
    return [number_of(decoder.jpeg(data)) for data in packets]


@pytest.mark.parametrize(("encoder", "options", "video_format"), ENCODERS)
def test_each_message_gives_its_own_frame(encoder: str, options: dict[str, str], video_format: str) -> None:
    packets = encoded(FRAMES, encoder, options=options)
    assert numbers(packets, video_format) == list(range(FRAMES))


def test_a_picture_has_the_frames_size_and_colours() -> None:
    decoder = VideoDecoder("h264")
    jpeg = decoder.jpeg(encoded(1)[0])
    assert jpeg is not None
    assert width_and_height(jpeg) == (320, 160)
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert np.abs(picture.astype(int) - 30).max() <= 4


@pytest.mark.parametrize(("encoder", "options", "video_format"), ENCODERS)
def test_a_video_without_its_beginning_begins_at_a_key_frame(
    encoder: str, options: dict[str, str], video_format: str
) -> None:
    packets = encoded(FRAMES, encoder, options=options)[3:]
    assert numbers(packets, video_format) == [None] * (GOP - 3) + list(range(GOP, FRAMES))


@pytest.mark.parametrize("damage", ["noise", "cut off", "other bytes", "empty"])
@pytest.mark.parametrize(("encoder", "options", "video_format"), ENCODERS)
def test_a_damaged_message_costs_the_pictures_up_to_a_key_frame(
    encoder: str, options: dict[str, str], video_format: str, damage: str
) -> None:
    """Frames that build on it would be wrong."""
    packets = encoded(FRAMES, encoder, options=options)
    whole = packets[4]
    noise = np.random.default_rng(1).integers(0, 256, len(whole) - len(whole) // 3, np.uint8).tobytes()
    packets[4] = {
        "noise": whole[: len(whole) // 3] + noise,
        "cut off": whole[: len(whole) // 2],
        "other bytes": b"not a video" * 5,
        "empty": b"",
    }[damage]
    assert numbers(packets, video_format) == [0, 1, 2, 3] + [None] * (GOP - 4) + list(range(GOP, FRAMES))


def test_b_frames_are_refused() -> None:
    """Foxglove's format has none: their pictures come messages later."""
    with pytest.raises(RecordingError, match="B frames"):
        numbers(encoded(FRAMES, b_frames=2))


def grey_picture(width: int, height: int) -> bytes:
    """A key frame of one grey, written by hand: to encode a large one takes seconds and 600 MB (H.264, 7.3)."""

    def ue(number: int) -> str:
        bits = f"{number + 1:b}"
        return "0" * (len(bits) - 1) + bits

    def unit(kind: int, bits: str) -> bytes:
        bits += "1" + "0" * (-(len(bits) + 1) % 8)
        return bytes([0, 0, 1, kind]) + int(bits, 2).to_bytes(len(bits) // 8, "big")

    columns, rows = width // 16, height // 16
    profile_and_level = f"{66:08b}{0xC0:08b}{62:08b}"
    order_and_references = ue(0) + ue(0) + ue(2) + ue(1) + "0"
    sequence = profile_and_level + order_and_references + ue(columns - 1) + ue(rows - 1) + "1100"
    picture = ue(0) + ue(0) + "00" + ue(0) + ue(0) + ue(0) + "000" + ue(0) + ue(0) + ue(0) + "000"
    slice_header = ue(0) + ue(7) + ue(0) + "0000" + ue(0) + "00" + ue(0)
    block = ue(3) + ue(0) + ue(0) + "1"  # 16x16, predicted from its neighbours, without a difference
    return unit(0x67, sequence) + unit(0x68, picture) + unit(0x65, slice_header + block * columns * rows)


@pytest.mark.parametrize(("width", "height", "has_picture"), [(64, 32, True), (16384, 4112, False)])
def test_a_frame_of_too_many_pixels_is_not_decoded(width: int, height: int, has_picture: bool) -> None:
    assert (width * height <= MAX_PIXELS) is has_picture
    jpeg = VideoDecoder("h264").jpeg(grey_picture(width, height))
    assert (jpeg and width_and_height(jpeg)) == ((width, height) if has_picture else None)


@pytest.mark.parametrize("video_format", ["", "h263", "mpeg4", "libx", "_", "concat:/etc/passwd", "x" * 5000])
def test_other_formats_are_refused(video_format: str) -> None:
    with pytest.raises(RecordingError, match="h264, h265, vp9 and av1") as error:
        VideoDecoder(video_format)
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    ("name", "is_video"),
    [
        ("foxglove.CompressedVideo", True),
        ("foxglove_msgs/CompressedVideo", True),
        (FOXGLOVE_TYPE, True),
        (PACKET_TYPE, True),
        ("ffmpeg_image_transport_msgs/FFMPEGPacket", True),
        ("foxglove.CompressedImage", False),
        ("sensor_msgs/msg/CompressedImage", False),
        ("my.foxglove.CompressedVideo", False),
        ("", False),
    ],
)
def test_types_of_messages(name: str, is_video: bool) -> None:
    assert is_video_type(name) is is_video


@pytest.mark.parametrize(
    "message",
    [
        {"data": "AAAA"},
        {"format": 3, "data": "AAAA"},
        {"format": "h264"},
        {"format": "h264", "data": "?"},
        "h264",
        None,
        [1],
    ],
)
def test_a_message_without_a_video(message: object) -> None:
    with pytest.raises(FieldError):
        video_in(message)


@pytest.mark.parametrize("as_json", [False, True])
def test_frames_in_a_foxglove_log(tmp_path: Path, as_json: bool) -> None:
    packets = encoded(3)
    path = write_video_log(tmp_path / "drive.mcap", packets, as_json=as_json)
    with Log(path) as log:
        assert log.schemas == {WHEEL: "car.Wheel", VIDEO: CompressedVideo.DESCRIPTOR.full_name}
        found = [
            video_in(decoder_for(schema, channel)(message.data))
            for chunk in log.chunks
            for schema, channel, message in log.messages_of(chunk)
            if channel.topic == VIDEO
        ]
    assert found == [("h264", data) for data in packets]


@pytest.mark.parametrize("msgtype", [PACKET_TYPE, FOXGLOVE_TYPE])
def test_frames_in_a_ros2_bag(tmp_path: Path, msgtype: str) -> None:
    packets = encoded(3)
    folder = write_video_bag(tmp_path / "bag", StoragePlugin.SQLITE3, packets, msgtype)
    [path] = folder.glob("*.db3")
    found = [
        video_in(decoder_for(schema, channel)(message.data))
        for _, read in SqliteFile(path).places(VIDEO, "")
        for schema, channel, message in [read()]
    ]
    assert found == [("libx264", data) for data in packets]


def test_an_iterator_of_a_ros2_bag_is_closed_by_any_thread(tmp_path: Path) -> None:
    """Python collects what was left early in the thread that happens to run then."""
    [path] = write_video_bag(tmp_path / "bag", StoragePlugin.SQLITE3, encoded(3)).glob("*.db3")
    messages = SqliteFile(path).places(VIDEO, "")
    assert isinstance(messages, Generator)
    next(messages)
    with ThreadPoolExecutor() as pool:
        pool.submit(messages.close).result()


def test_an_import_decodes_a_log_s_video_and_reports_so(tmp_path: Path) -> None:
    """The first frames have no key frame before them; pictures without steering in time are decoded, too."""
    source = write_video_log(tmp_path / "video.mcap", encoded(FRAMES)[3:])
    settings = ImportSettings(image=VIDEO, steering=VIDEO_TOPICS.steering)
    done = import_recording(source, tmp_path / "log.mcap", settings)
    pictures = [number_of(picture.data) for _, picture in read_messages(done.path)["/camera/center"]]
    assert pictures == list(range(GOP, FRAMES))
    assert done.skipped.counts == {
        "messages of a video without a whole picture (after damage, until a key frame)": GOP - 3
    }
    assert done.notices == ["decoded from videos and encoded anew: these are not the camera's original pictures"]


def test_an_import_decodes_a_bag_s_video(tmp_path: Path) -> None:
    bag = write_video_bag(tmp_path / "bag", StoragePlugin.SQLITE3, encoded(FRAMES))
    done = import_recording(bag, tmp_path / "log.mcap", ROS_VIDEO_TOPICS)
    pictures = [number_of(picture.data) for _, picture in read_messages(done.path)["/camera/center"]]
    assert pictures == list(range(FRAMES))


WHOLE = [jpeg(100 + number, number + 1) for number in range(20)]
CUT_OFF = WHOLE[0][: len(WHOLE[0]) // 2]
BROKEN: dict[tuple[Camera, int], bytes] = {
    ("center", 3): CUT_OFF,
    ("left", 0): b"",
    ("left", 7): CUT_OFF,
    ("left", 8): b"no picture",
    ("right", 19): CUT_OFF,
}


def picture(camera: Camera, row: int) -> bytes:
    """No two rows of a camera have the same."""
    return BROKEN.get((camera, row)) or (b"" if (camera, row) in BROKEN else WHOLE[row])


def frozen_right(camera: Camera, row: int) -> bytes:
    """The right camera has one picture in eight rows."""
    return WHOLE[4] if camera == "right" and 4 <= row < 12 else picture(camera, row)


def write_drive(
    path: Path,
    speed_mph: Sequence[float] = (9.0,) * 20,
    picture: Callable[[Camera, int], bytes] = picture,
) -> Path:
    """A log of one row of three pictures for each speed."""
    with LogWriter(path, {"source": "test"}, overwrite=True) as writer:
        for row, speed in enumerate(speed_mph):
            time_ns = START_NS + row * STEP_NS
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, picture(camera, row))
            writer.vehicle(time_ns, row, VehicleState(steering=row / 100, speed_mph=speed))
    return path


def findings(path: Path, kind: str) -> list[str]:
    return [finding.where for finding in check(path).findings if finding.kind == kind]


def fingerprint(path: Path) -> str:
    with Log(path) as log:
        return log.fingerprint


# The pictures themselves


def test_every_undecodable_picture_is_named_in_order_and_counted() -> None:
    reported: list[int] = []
    with ThreadPoolExecutor(2) as pool:
        image_check = ImageCheck(pool, reported.append)
        for row in range(150):
            image_check.add("/a", row, row, CUT_OFF if row in (0, 77) else WHOLE[row % 20])
            image_check.add("/b", row, row, b"" if row == 31 else WHOLE[(row + 1) % 20])
        image_check.finish()
    assert image_check.broken == [("/a", 0), ("/b", 31), ("/a", 77)]
    assert image_check.decoded == sum(reported) == 300


@pytest.mark.parametrize(
    ("pictures", "moves", "expected"),
    [
        ("abcdef", "111111", []),
        ("aabbcc", "111111", []),  # a slow camera
        ("abbbcd", "111111", [(1, 3)]),
        ("aaabbb", "111111", [(0, 2), (3, 5)]),
        ("aaaaaa", "111111", [(0, 5)]),
        ("aaaaaa", "000000", []),  # the car stands: it sees the same
        ("aaaaaa", "000111", [(2, 5)]),
        ("aaaaaa", "001011", [(3, 5)]),
        ("ab" * 3, "111111", []),
        ("", "", []),
    ],
)
def test_three_equal_pictures_in_a_row_from_a_moving_car_are_frozen(
    pictures: str, moves: str, expected: list[tuple[int, int]]
) -> None:
    image_check = ImageCheck(None)
    for i, name in enumerate(pictures):
        image_check.add("/a", 100 + i, 5 * i, name.encode())
    standing = {(100 + i, 5 * i) for i, moving in enumerate(moves) if moving == "0"}
    assert [
        stretch for pictures in image_check.pictures.values() for stretch in pictures.frozen(standing)
    ] == expected


# bc-log check


def test_check_shows_frozen_and_broken_pictures_from_sound_ones(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "a.mcap", [9.0] * 10 + [0.0] * 10, frozen_right)
    assert findings(path, "pictures that do not decode") == [
        *("/camera/left row 0", "/camera/center row 3", "/camera/left row 7", "/camera/left row 8"),
        "/camera/right row 19",
    ]
    assert findings(path, "stretches of frozen pictures") == ["/camera/right rows 4 to 9"]  # from 10 on it stands
    assert check(path).pictures == 60
    assert check(path, look=False).pictures == 0


@pytest.mark.parametrize("topic", ["/vehicle", "/camera/center"])
def test_a_time_that_no_clock_shows_is_a_finding(tmp_path: Path, topic: str) -> None:
    path = tmp_path / "late.mcap"
    schema = "bc.VehicleState" if topic == "/vehicle" else "foxglove.CompressedImage"
    with plain_writer(path) as writer:
        channel = writer.register_channel(topic, "protobuf", writer.register_schema(schema, "protobuf", b""))
        writer.add_message(channel, 2**63, b"", 2**63, 7)
    assert findings(path, "impossible times") == [f"{topic} row 7"]


# The look of an index


def test_looking_at_a_log_finds_what_was_put_into_it(tmp_path: Path) -> None:
    reported: list[int] = []
    with Log(write_drive(tmp_path / "a.mcap", picture=frozen_right)) as log:
        looked = check_images(log, reported.append)
    assert looked == ImageFindings(
        60,
        {"center": ((3, 3),), "left": ((0, 0), (7, 8)), "right": ((19, 19),)},
        {"right": ((4, 11),)},
        (),
    )
    assert sum(reported) == 60


@pytest.mark.parametrize("speed_mph", [[0.0] * 20, [float("nan")] * 20])
def test_a_car_whose_speed_is_unknown_counts_as_moving(tmp_path: Path, speed_mph: list[float]) -> None:
    with Log(write_drive(tmp_path / "a.mcap", speed_mph, lambda camera, row: WHOLE[0])) as log:
        frozen = check_images(log).frozen
    assert frozen == ({} if speed_mph[0] == 0 else dict.fromkeys(CAMERAS, ((0, 19),)))


def test_an_unchanged_log_is_looked_at_once(tmp_path: Path) -> None:
    logs = {name: write_drive(tmp_path / f"{name}.mcap") for name in ("a", "b")}
    index = tmp_path / "index"
    assert check_all_images(logs, index) == ["a", "b"]
    assert check_all_images(logs, index) == []
    for name, path in logs.items():
        with Log(path) as log:
            assert read_image_check(index, name, log.fingerprint) == check_images(log)
    write_drive(logs["b"], picture=lambda camera, row: WHOLE[row])
    assert read_image_check(index, "b", fingerprint(logs["b"])) is None
    assert check_all_images(logs, index) == ["b"]
    looked = read_image_check(index, "b", fingerprint(logs["b"]))
    assert looked is not None
    assert not any(looked.broken.values())


@pytest.mark.parametrize("text", ["", "[]", '{"format": 1, "fingerprint": "f", "pictures": 10, "broken": {}}'])
def test_a_damaged_look_counts_as_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "looks").mkdir()
    (tmp_path / "looks" / "a.json").write_text(text)
    assert read_image_check(tmp_path, "a", "f") is None
