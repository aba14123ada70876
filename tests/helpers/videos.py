"""Videos as other programs put them into their logs: a message a frame, whose brightness tells its number."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import get_types_from_msg

from tests.helpers.imports import topics
from tests.helpers.other_logs import (
    START_NS,
    STORE,
    TWIST_TYPE,
    VIDEO,
    WHEEL,
    S,
    Told,
    angle,
    header,
    twist,
    write_mcap,
)

GOP = 10  # frames from one key frame to the next
FRAME_S = 0.05
VIDEO_TOPICS = topics(VIDEO, f"{WHEEL}.steering.angle")
ROS_VIDEO_TOPICS = topics(VIDEO, "/cmd_vel.angular.z", steering_scale=-1.0)

PACKET_TYPE = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
FOXGLOVE_TYPE = "foxglove_msgs/msg/CompressedVideo"
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
        "bool is_bigendian\nuint8[] data",
        PACKET_TYPE,
    )
)
STORE.register(
    get_types_from_msg(
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format", FOXGLOVE_TYPE
    )
)


def level(number: int) -> int:
    """The grey of a frame."""
    return 30 + 5 * number


def number_of(jpeg: bytes | None) -> int | None:
    """The number of the frame that a picture shows; None without a picture."""
    if jpeg is None:
        return None
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert picture.std() < 2
    return round((float(picture.mean()) - level(0)) / 5)


def encoded(
    frames: int,
    encoder: str = "libx264",
    *,
    size: tuple[int, int] = (320, 160),
    b_frames: int = 0,
    options: dict[str, str] | None = None,
) -> list[bytes]:
    """The packets of a video, one a frame; with B frames, in the order of the stream."""
    codec: Any = av.CodecContext.create(encoder, "w")
    codec.width, codec.height = size
    codec.pix_fmt, codec.time_base, codec.framerate = "yuv420p", Fraction(1, 20), Fraction(20)
    codec.gop_size, codec.max_b_frames, codec.thread_count = GOP, b_frames, 1
    codec.options = options or {}
    packets = []
    for number in range(frames):
        planes = np.full((size[1] * 3 // 2, size[0]), 128, np.uint8)  # Y above U and V
        planes[: size[1]] = round(16 + level(number) * 219 / 255)
        frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        frame.pts = number
        packets += codec.encode(frame)
    return [bytes(packet) for packet in [*packets, *codec.encode(None)]]


def write_video_log(
    path: Path, packets: Sequence[bytes], *, video_format: str = "h264", as_json: bool = False, **options: Any
) -> Path:
    """An MCAP file with a steering (in JSON) and a frame, 1 ms later, every 50 ms: the steering of frame n is
    n / 100."""
    messages: list[Told] = []
    for number, data in enumerate(packets):
        text = {"timestamp": {"sec": 0, "nsec": 0}, "frame_id": "camera", "format": video_format}
        video = (
            {**text, "data": base64.b64encode(data).decode()}
            if as_json
            else CompressedVideo(frame_id="camera", data=data, format=video_format)
        )
        messages += [
            (WHEEL, FRAME_S * number, angle(number / 100)),
            (VIDEO, FRAME_S * number + 0.001, video),
        ]
    return write_mcap(path, messages, **options)


def ros_video(msgtype: str, data: bytes, video_format: str) -> Any:
    """A message of ffmpeg_image_transport or of Foxglove's types for ROS 2."""
    kind, content = STORE.types[msgtype], np.frombuffer(data, np.uint8)
    if msgtype == PACKET_TYPE:
        return kind(header(), 320, 160, video_format, 0, 0, False, content)
    return kind(header().stamp, "camera", content, video_format)


def write_video_bag(
    folder: Path,
    storage: StoragePlugin,
    packets: Sequence[bytes],
    msgtype: str = PACKET_TYPE,
    video_format: str = "libx264",
) -> Path:
    """A ROS 2 bag with the times and steering of `write_video_log`; the sign is ROS's, left positive."""
    with BagWriter(folder, version=9, storage_plugin=storage) as writer:
        wheel = writer.add_connection("/cmd_vel", TWIST_TYPE, typestore=STORE)
        camera = writer.add_connection(VIDEO, msgtype, typestore=STORE)
        for number, data in enumerate(packets):
            time_ns = START_NS + round(FRAME_S * number * S)
            writer.write(wheel, time_ns, STORE.serialize_cdr(twist(-number / 100)[2], TWIST_TYPE))
            video = STORE.serialize_cdr(ros_video(msgtype, data, video_format), msgtype)
            writer.write(camera, time_ns + S // 1000, video)
    return folder
