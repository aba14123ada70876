"""A file as it is sent to a store: in parts, which go by their numbers, several at once."""

from __future__ import annotations

from collections.abc import Callable, Container
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Final, TypeAlias

from common.errors import StoreError

OnBytes: TypeAlias = Callable[[int], object]
"""Called with the number of bytes transferred since the last call; negative if earlier ones do not count."""

AT_ONCE: Final = 4
"""Parts that are on their way at a time."""
MAX_PARTS: Final = 9000
"""Of a file; a store takes 10,000, and more."""


class PartedFile:
    """A file of which a part is read at a time."""

    def __init__(self, path: Path, part_bytes: int) -> None:
        """`part_bytes`: of each part but the last; more where there would be too many."""
        self.path = path
        self._status = path.stat()
        self._part_bytes = max(part_bytes, -(-self._status.st_size // MAX_PARTS))
        self.count = -(-self._status.st_size // self._part_bytes)

    def length(self, number: int) -> int:
        """Bytes of a part, the first of which is 1; none of one that is not of this file."""
        return max(0, min(self._part_bytes, self._status.st_size - (number - 1) * self._part_bytes))

    def read(self, number: int) -> bytes:
        with self.path.open("rb") as stream:
            stream.seek((number - 1) * self._part_bytes)
            return stream.read(self.length(number))

    def send_missing(self, sent: Container[int], send: Callable[[int], object]) -> None:
        """Call `send` with the number of each part that is not in `sent`. Raises what it does, when those that are
        on their way have arrived."""
        pool = ThreadPoolExecutor(AT_ONCE, "upload")
        try:
            missing = [number for number in range(1, self.count + 1) if number not in sent]
            for done in as_completed([pool.submit(send, number) for number in missing]):
                done.result()
        finally:
            pool.shutdown(cancel_futures=True)

    def is_changed(self) -> bool:
        """True if the file is not what it was when this was made."""
        status = self.path.stat()
        return (status.st_size, status.st_mtime_ns) != (self._status.st_size, self._status.st_mtime_ns)

    def changed_error(self) -> StoreError:
        return StoreError(f"{self.path}: was changed while it was copied; give the command again")
