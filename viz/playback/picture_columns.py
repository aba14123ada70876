"""Pictures as columns of a Rerun recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa
import rerun as rr

_BLOB: Final = pa.list_(pa.field("item", pa.uint8(), nullable=False))


def picture_columns(encoded: Sequence[bytes], formats: Sequence[str]) -> rr.ComponentColumnList:
    """Columns with one picture a row, byte for byte; `formats` are "jpeg", "png" and such. Their coordinate frame
    is the one that Rerun gives every entity."""
    media_types = [f"image/{name or 'jpeg'}" for name in formats]
    return rr.EncodedImage.columns(blob=_blobs(encoded), media_type=media_types)


def _blobs(encoded: Sequence[bytes]) -> pa.Array:
    """Bytes as Rerun stores them; it would convert them one by one."""
    ends = np.cumsum([0, *map(len, encoded)])
    values = pa.Array.from_buffers(pa.uint8(), int(ends[-1]), [None, pa.py_buffer(b"".join(encoded))])
    return pa.ListArray.from_arrays(pa.array(ends, pa.int32()), values, type=_BLOB)
