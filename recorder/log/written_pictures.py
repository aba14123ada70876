"""The pictures of a log that is being written, read back from its file."""

from __future__ import annotations

from pathlib import Path

from common.closeable import Closeable
from common.random_access import LocalFile
from recorder.mcap.message_index import UNCOMPRESSED
from recorder.mcap.picture_places import Pictures


class WrittenPictures(Closeable):
    """The pictures of one topic, whatever topic is asked for."""

    def __init__(self, part: Path, pictures: Pictures) -> None:
        """Raises OSError."""
        self._file = LocalFile(part)
        self._pictures = pictures

    def pictures(self, topic: str) -> Pictures:
        return self._pictures

    def read(self, offset: int, length: int, chunk: int = UNCOMPRESSED) -> bytes:
        return self._file.read(offset, length)

    def close(self) -> None:
        self._file.close()
