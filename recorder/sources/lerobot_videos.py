"""The frames of a LeRobot dataset's videos, in the order of its rows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from common.closeable import Closeable
from common.errors import printable
from recorder.errors import RecordingError
from recorder.lerobot.dataset_format import VIDEO_PATH, FileNumber
from recorder.pictures.picture_size import MAX_PIXELS
from recorder.sources.compressed_video import jpeg_of
from recorder.sources.lerobot_dataset import LeRobotFolder

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

_MAX_S: Final = 1e9  # in a video: thirty years


class CameraVideos(Closeable):
    """The videos of one camera, read from the first row to the last."""

    def __init__(self, dataset: LeRobotFolder, key: str) -> None:
        """Raises RecordingError if a video is missing."""
        import av  # slow

        self._av = av
        if dataset.video_path != VIDEO_PATH:
            raise RecordingError(
                f"{dataset.root}: videos in {printable(dataset.video_path[:100])!r}; expected {VIDEO_PATH}"
            )
        prefix = f"videos/{key}"
        columns = [
            "episode_index",
            *(f"{prefix}/{name}" for name in ("chunk_index", "file_index", "from_timestamp")),
        ]
        table = dataset.episode_table(columns)
        self._places: dict[int, tuple[Path, float]] = {}
        paths: dict[tuple[int, int], Path] = {}
        for row in table.to_pylist():
            episode, chunk, file, start_s = (row[name] for name in columns)
            try:
                number = int(chunk), int(file)
                if number not in paths:
                    relative = FileNumber(*number).path(VIDEO_PATH, video_key=key)
                    paths[number] = dataset.file(dataset.root / relative)
                    if not paths[number].is_file():
                        raise RecordingError(
                            f"{dataset.root / relative}: not there; download the dataset with its videos"
                        )
                if not abs(start_s) < _MAX_S:
                    raise ValueError(start_s)
                self._places[int(episode)] = paths[number], float(start_s)
            except (TypeError, ValueError, OverflowError):
                raise RecordingError(f"{dataset.root}: meta/episodes does not have the places of videos") from None
        self._tolerance_s = 0.5 / dataset.fps
        self._episode = -1
        self._path: Path | None = None
        self._container: InputContainer | None = None
        self._frames: Iterator[VideoFrame] = iter(())
        self._next: VideoFrame | None = None

    def jpeg(self, episode: int, time_s: float) -> bytes | None:
        """The frame of an episode at a time, encoded anew; None if there is none.

        Call it with ascending times of each episode. Raises RecordingError if a video cannot be decoded.
        """
        if episode not in self._places:
            return None
        path, start_s = self._places[episode]
        try:
            if episode != self._episode:
                self._go_to(episode, path, start_s)
            wanted_s = start_s + time_s
            while self._next is None or (self._next.time or 0.0) < wanted_s - self._tolerance_s:
                self._next = next(self._frames, None)
                if self._next is None:
                    return None
            if abs((self._next.time or 0.0) - wanted_s) > self._tolerance_s:
                return None
            return jpeg_of(self._next)
        except (self._av.FFmpegError, ValueError) as error:
            raise RecordingError(
                f"{path}: the video cannot be decoded ({printable(str(error)[:200])}); download it again"
            ) from None

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container = None

    def _go_to(self, episode: int, path: Path, start_s: float) -> None:
        if path != self._path or self._container is None:
            self.close()
            # the format is given: FFmpeg's guess may follow a list of other files that is named .mp4
            self._container = self._av.open(f"file:{path}", "r", format="mp4")
            self._path = path
        if not self._container.streams.video:
            raise RecordingError(f"{path}: no video in it; download it again")
        stream: Any = self._container.streams.video[0]
        if not 0 < stream.width * stream.height <= MAX_PIXELS:
            raise RecordingError(f"{path}: a video of {stream.width} x {stream.height} pixels is not a camera's")
        self._container.seek(max(0, int(start_s / stream.time_base) - 1), backward=True, stream=stream)
        self._frames = self._container.decode(stream)
        self._next, self._episode = None, episode
