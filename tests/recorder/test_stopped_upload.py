"""Copies of logs to S3 in several parts, stopped and killed."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from common.errors import StoreError
from recorder.log_cli import main
from recorder.upkeep.copy_log import copy_log
from tests.helpers.bucket import Bucket, in_parts_of, unfinished_parts
from tests.helpers.faulty_proxy import Passing
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

PARTS = 6
AT_ONCE = 4  # parts that travel while others are given up may still arrive


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log that is sent in six parts; a.mcap."""
    path = write_log(tmp_path / "here/a.mcap", [0.1] * 60)
    in_parts_of(monkeypatch, -(-path.stat().st_size // PARTS))
    return path


def contents(bucket: Bucket) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in bucket.folder.iterdir()}


def is_part(passing: Passing, number: int) -> bool:
    return passing.command == "PUT" and f"partNumber={number}&" in passing.path


def test_a_copy_that_failed_begins_anew(bucket: Bucket, log: Path) -> None:
    bucket.answer = lambda passing: is_part(passing, 5) and passing.fail(400, "ExpiredToken")
    with pytest.raises(StoreError, match="ExpiredToken"):
        copy_log(log, bucket.url("a.mcap"))
    assert contents(bucket) == {}
    assert len(unfinished_parts(bucket)) < AT_ONCE
    bucket.pass_all()
    assert copy_log(log, bucket.url("a.mcap")).is_new
    assert sum(method == "PUT" and "partNumber" in path for method, path, _ in bucket.requests) >= PARTS
    assert contents(bucket) == {"a.mcap": log.read_bytes()}
    bucket.pass_all()
    assert not copy_log(log, bucket.url("a.mcap")).is_new
    assert bucket.count("PUT") == 0


def test_ctrl_c_ends_a_copy(bucket: Bucket, log: Path) -> None:
    def interrupt(passing: Passing) -> bool:
        if is_part(passing, 2):
            os.kill(os.getpid(), signal.SIGINT)
        return False

    bucket.answer = interrupt
    assert call(main, "copy", log, bucket.url()) == 130
    bucket.pass_all()
    assert contents(bucket) == {}
    assert len(unfinished_parts(bucket)) < AT_ONCE
