"""Pictures from messages that hold a frame of video each: foxglove.CompressedVideo, and ROS's FFMPEGPacket.

https://docs.foxglove.dev/docs/sdk/schemas/compressed-video
https://github.com/ros-misc-utilities/ffmpeg_image_transport_msgs
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import cv2

from common.errors import brief
from recorder.errors import RecordingError
from recorder.pictures.picture_size import MAX_PIXELS
from recorder.sources.mcap_messages import FieldError, picture_in

if TYPE_CHECKING:
    from av import VideoFrame

JPEG_QUALITY: Final = 95
_MAX_SIDE: Final = 65_500  # of a JPEG that OpenCV encodes: above it, it prints an error

_VIDEO_TYPE: Final = re.compile(
    r"(foxglove|foxglove_msgs)[./](msg/)?CompressedVideo|ffmpeg_image_transport_msgs[./](msg/)?FFMPEGPacket"
)
# FFmpeg's decoders. FFMPEGPacket names the encoder: libx264, h264_nvenc.
_DECODERS: Final = {
    "h264": "h264",
    "libx264": "h264",
    "libopenh264": "h264",
    "h265": "hevc",
    "hevc": "hevc",
    "libx265": "hevc",
    "vp9": "vp9",
    "libvpx-vp9": "vp9",
    "av1": "libdav1d",  # FFmpeg's own needs a GPU
    "libaom-av1": "libdav1d",
    "libsvtav1": "libdav1d",
}


def is_video_type(name: str) -> bool:
    return _VIDEO_TYPE.fullmatch(name) is not None


def video_in(message: object) -> tuple[str, bytes]:
    """The video's format and the bytes of one frame. Raises FieldError without them."""
    for field in ("format", "encoding"):
        value = message.get(field) if isinstance(message, Mapping) else getattr(message, field, None)
        if isinstance(value, str):
            return value, picture_in(message)
    raise FieldError("no format of a video")


class VideoDecoder:
    """Decodes the frames of one topic. Each builds on those before it: give it every message, in order."""

    def __init__(self, video_format: str) -> None:
        """`video_format`: as `video_in` returns it. Raises RecordingError if it cannot be decoded."""
        import av  # slow

        self._av = av
        name = video_format.partition(";")[0].strip().lower()  # the pixels' formats follow
        try:
            decoder = _DECODERS.get(name) or _DECODERS[name.partition("_")[0]]  # h264_nvenc, av1_vaapi
            self._codec: Any = av.CodecContext.create(decoder, "r")
        except (KeyError, av.codec.codec.UnknownCodecError):
            raise RecordingError(
                f"video in the format {brief(video_format)!r}; h264, h265, vp9 and av1 can be decoded"
            ) from None
        self._codec.thread_count = 1  # several would each hold a frame back
        self._codec.options = {"max_pixels": str(MAX_PIXELS)}  # held before a picture's memory is taken

    def jpeg(self, data: bytes) -> bytes | None:
        """The picture of one message, encoded anew.

        None before the first key frame, for data that cannot be decoded, and then until the next key frame.
        Raises RecordingError for a video whose frames do not come out in the order of the messages.
        """
        try:
            picture = self._decoded(data)
        except (self._av.FFmpegError, ValueError):
            picture = None
        if picture is None:
            self._codec.flush_buffers()  # a frame that builds on a damaged one would be wrong, too
        return picture

    def _decoded(self, data: bytes) -> bytes | None:
        frames = self._codec.decode(self._av.Packet(data))
        if not frames and self._codec.has_b_frames:
            raise RecordingError("a video with B frames, which cannot be decoded message by message")
        if len(frames) != 1 or frames[0].is_corrupt:
            return None
        return jpeg_of(frames[0])


def jpeg_of(frame: VideoFrame) -> bytes | None:
    """A frame of a video, encoded as JPEG; None if it is too long or too high for one."""
    if max(frame.width, frame.height) > _MAX_SIDE:
        return None
    is_encoded, jpeg = cv2.imencode(
        ".jpg", frame.to_ndarray(format="bgr24"), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    return jpeg.tobytes() if is_encoded else None
