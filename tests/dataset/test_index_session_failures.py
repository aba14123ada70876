"""What goes wrong while one session is looked at leaves that session out of the index, and no other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from dataset.cli import main
from panorama import views, write_drive
from udacity import call

ROWS = 660  # over a minute: of less, no lag is measured when it is written


def encoded(width: int, height: int) -> bytes:
    ok, data = cv2.imencode(".jpg", np.full((height, width), 90, np.uint8))
    assert ok
    return data.tobytes()


@pytest.fixture
def sessions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path / "sessions" / "lake.mcap", views(ROWS))
    return tmp_path / "sessions"


def indexed_sessions() -> set[str]:
    return set(pq.read_table("index/samples.parquet")["session"].to_pylist())


@pytest.mark.parametrize("size", [(320, 4), (1, 1), (1, 60_000), (60_000, 1)], ids=str)
@pytest.mark.parametrize("flags", [[], ["--look"]], ids=["plain", "look"])
def test_pictures_of_odd_shapes_do_not_stop_an_index(
    size: tuple[int, int], flags: list[str], sessions: Path
) -> None:
    write_drive(sessions / "odd.mcap", [encoded(*size)] * ROWS)
    assert call(main, *flags) == 0
    assert indexed_sessions() == {"lake", "odd"}


def test_a_log_that_is_a_link_to_itself_is_left_out(sessions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (sessions / "loop.mcap").symlink_to("loop.mcap")
    assert call(main) == 3
    assert "loop.mcap: cannot be opened" in capsys.readouterr().err
    assert indexed_sessions() == {"lake"}
