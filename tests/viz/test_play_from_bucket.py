"""`bc-play s3://...`: the log comes here while it is shown."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from tests.helpers.bucket import serving_bucket
from tests.helpers.logs import write_log
from tests.helpers.udacity import call, jpeg
from viz.cli import main


def test_a_log_in_a_store_is_shown_as_one_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with serving_bucket(tmp_path / "server", monkeypatch) as bucket:
        log = write_log(bucket.folder / "b.mcap", [0.1] * 5, lambda camera, row: jpeg(50 + row))
        for name, place in (("here", log), ("there", bucket.url("b.mcap"))):
            assert call(main, place, "--video", tmp_path / f"{name}.mp4") == 0
        assert (tmp_path / "here.mp4").read_bytes() == (tmp_path / "there.mp4").read_bytes()
        assert list((tmp_path / "temporary").iterdir()) == []
        bucket.requests.clear()
        assert call(main, bucket.url("b.mcap"), "--video", tmp_path / "x.mp4", "--web") == 2
        assert bucket.count() == 0  # nothing came for flags that do not go together
        assert call(main, bucket.url("b.mcap"), "--follow") == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "must be on this machine: run `bc-log copy" in told
