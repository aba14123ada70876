"""A real S3 server (localbucket) in this process, behind a proxy that counts and fails as it is told."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import localbucket
import pytest

from common import object_store, store_connection
from common.location import Url
from recorder.upkeep import copy_log
from tests.helpers.faulty_proxy import Answer as Answer
from tests.helpers.faulty_proxy import FaultyProxy, serving
from tests.helpers.places import KEYS, Handler


class Bucket(FaultyProxy):
    """The bucket `logs` of a server, as a folder of this machine; what it is asked for; how it fails."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder / "logs"
        self.folder.mkdir(parents=True)

    def url(self, key: str = "") -> Url:
        return Url("s3", "logs", key)


def in_parts_of(patch: pytest.MonkeyPatch, size: int) -> None:
    """Logs are sent in parts of so many bytes, which no store would take."""
    for module in (copy_log, object_store):
        patch.setattr(module, "MAX_READ_AHEAD", size)
    patch.setattr(localbucket, "MIN_PART_SIZE", 0)


def unfinished_parts(bucket: Bucket) -> list[Path]:
    """The parts that the server keeps of uploads which are not finished."""
    return sorted((bucket.folder.parent / localbucket.UPLOADS_DIR).glob("*/[0-9]*"))


def end_uploads(bucket: Bucket) -> None:
    """The server forgets the uploads that are not finished, of which some have no part yet."""
    for upload in (bucket.folder.parent / localbucket.UPLOADS_DIR).glob("*"):
        shutil.rmtree(upload)


@contextlib.contextmanager
def serving_bucket(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    """Serve a bucket from `folder`; s3:// leads there as long as it runs, in this process and its children."""
    bucket = Bucket(folder)
    handler = type("Handler", (Handler,), {"data_root": folder})
    with serving(handler) as server_port, bucket.before(server_port):
        for name, value in {"AWS_ENDPOINT_URL_S3": bucket.endpoint, **KEYS}.items():
            monkeypatch.setenv(name, value)
        store_connection.forget_stores()
        try:
            yield bucket
        finally:
            store_connection.forget_stores()
