"""A file of Rerun's appears whole, and over another one only where that was asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from common import UserError
from viz.rrd_file import rrd_file


def test_a_file_that_somebody_writes_meanwhile_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.rrd"
    with (
        pytest.raises(UserError, match="written by another process at the same time"),
        rrd_file(path, overwrite=False),
    ):
        path.write_bytes(b"precious")
    assert path.read_bytes() == b"precious"
