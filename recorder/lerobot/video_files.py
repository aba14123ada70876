"""Writes the video files of a dataset: `videos/KEY/chunk-000/file-000.mp4`, in H.264."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from common import UserError
from recorder.lerobot.dataset_format import MEBIBYTE, VIDEO_FILE_MB, VIDEO_PATH, FileNumber

if TYPE_CHECKING:
    from av.container import OutputContainer

CODEC: Final = "libx264"
# g: every other picture is a key frame, as in LeRobot's videos; bf: pictures are stored in order
_ENCODER: Final = {"preset": "veryfast", "crf": "23", "g": "2", "bf": "0"}
_BT601: Final = 6  # SMPTE 170M, which swscale converts to


class VideoFiles:
    """Writes the pictures of one camera. An episode begins a new file if the old one has the format's size."""

    def __init__(self, root: Path, key: str, fps: int, size: tuple[int, int]) -> None:
        """`size`: width and height. Raises UserError for an odd size."""
        import av  # slow

        self._av = av
        if size[0] % 2 or size[1] % 2:
            raise UserError(f"--video: pictures of {size[0]} x {size[1]} pixels: H.264 needs even numbers")
        self._root, self._key, self._fps, self._size = root, key, fps, size
        self._number = FileNumber()
        self._container: OutputContainer | None = None
        self._stream: Any = None
        self._path = root
        self._frames = self._first = 0

    def begin_episode(self) -> None:
        if self._container is not None and self._path.stat().st_size > VIDEO_FILE_MB * MEBIBYTE:
            self.close()
            self._number = self._number.next()
        if self._container is None:
            self._begin_file()
        self._first = self._frames

    def add(self, bgr: NDArray[np.uint8]) -> None:
        frame = self._av.VideoFrame.from_ndarray(bgr, format="bgr24")
        frame.pts, frame.time_base = self._frames, Fraction(1, self._fps)
        if self._container is None:
            raise ValueError("no episode was begun")
        self._container.mux(self._stream.encode(frame))
        self._frames += 1

    def episode_columns(self) -> dict[str, float | int]:
        """The place of the last episode, for `meta/episodes`."""
        return {
            f"videos/{self._key}/chunk_index": self._number.chunk,
            f"videos/{self._key}/file_index": self._number.file,
            f"videos/{self._key}/from_timestamp": self._first / self._fps,
            f"videos/{self._key}/to_timestamp": self._frames / self._fps,
        }

    def close(self) -> None:
        if self._container is not None:
            self._container.mux(self._stream.encode())
            self._container.close()
            self._container = None

    def _begin_file(self) -> None:
        self._path = self._root / self._number.path(VIDEO_PATH, video_key=self._key)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # FFmpeg takes what is before a colon in a name for a protocol
        self._container = self._av.open(f"file:{self._path}", "w", format="mp4")
        self._stream = self._container.add_stream(CODEC, rate=self._fps, options=_ENCODER)
        self._stream.width, self._stream.height = self._size
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = Fraction(1, self._fps)
        self._stream.codec_context.colorspace = _BT601
        self._frames = 0


def video_info(fps: int, size: tuple[int, int]) -> dict[str, object]:
    """The entries of a video in `meta/info.json`, as lerobot's `datasets/video_utils.py` writes them."""
    return {
        "video.height": size[1],
        "video.width": size[0],
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.fps": fps,
        "video.channels": 3,
        "video.g": int(_ENCODER["g"]),
        "video.crf": int(_ENCODER["crf"]),
        "video.preset": _ENCODER["preset"],
        "has_audio": False,
        "is_depth_map": False,
    }
