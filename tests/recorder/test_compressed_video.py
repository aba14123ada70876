"""Frames of a video in a log's messages become pictures: each its own message's, or none."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from rosbags.rosbag2 import StoragePlugin

from recorder import Log, RecordingError
from recorder.pictures.picture_size import width_and_height
from recorder.sources.compressed_video import VideoDecoder, is_video_type, video_in
from recorder.sources.mcap_messages import FieldError, decoder_for
from recorder.sources.recording_kinds import import_recording
from recorder.sources.ros2_bag import SqliteFile
from recorder.sources.settings import ImportSettings
from tests.helpers.logs import read_messages
from tests.helpers.other_logs import VIDEO, WHEEL
from tests.helpers.videos import (
    FOXGLOVE_TYPE,
    GOP,
    PACKET_TYPE,
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
        for schema, channel, message in SqliteFile(path).messages(VIDEO, "")
    ]
    assert found == [("libx264", data) for data in packets]


def test_an_import_decodes_a_log_s_video_and_says_so(tmp_path: Path) -> None:
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
