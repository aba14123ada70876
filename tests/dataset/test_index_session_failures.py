"""What goes wrong while one session is looked at leaves that session out of the index, and no other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from dataset.cli import main
from tests.helpers.panorama import views, write_drive
from tests.helpers.udacity import call, encode

ROWS = 660  # over a minute: of less, no lag is measured when it is written


@pytest.fixture
def sessions(cwd: Path) -> Path:
    write_drive(cwd / "sessions" / "lake.mcap", views(ROWS))
    return cwd / "sessions"


def indexed_sessions() -> set[str]:
    return set(pq.read_table("index/samples.parquet")["session"].to_pylist())


@pytest.mark.parametrize("flags", [[], ["--look"]], ids=["plain", "look"])
def test_pictures_of_odd_shapes_do_not_stop_an_index(flags: list[str], sessions: Path) -> None:
    for width, height in [(320, 4), (1, 1), (1, 60_000), (60_000, 1)]:
        write_drive(sessions / f"{width}x{height}.mcap", [encode(np.full((height, width), 90, np.uint8))] * ROWS)
    assert call(main, *flags) == 0
    assert indexed_sessions() == {"lake", "320x4", "1x1", "1x60000", "60000x1"}
