"""The errors of this room."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from common import UserError


class DatasetError(UserError):
    """An index that is missing, empty, damaged, or older than its logs; a picture that cannot be decoded."""


class UnusablePictureError(DatasetError):
    """A picture that cannot be shown: it is left out, and the others are not. `kind` is that of its reason."""

    def __init__(self, kind: str, why: str) -> None:
        super().__init__(why)
        self.kind = kind


@contextlib.contextmanager
def index_write_errors(path: Path) -> Iterator[None]:
    """Raise DatasetError, which names `path`, for an OSError in the block: those of pyarrow name no file."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else " ".join(str(error).split())
        raise DatasetError(f"{path}: cannot be written ({reason})") from None
