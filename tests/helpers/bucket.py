"""A real S3 server (localbucket) in this process, behind a proxy that counts and fails as it is told."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import localbucket
import pytest

from common import object_store
from common.location import Url
from faulty_proxy import Answer as Answer
from faulty_proxy import FaultyProxy, serving


class Bucket(FaultyProxy):
    """The bucket `logs` of a server, as a folder of this machine; what it is asked for; how it fails."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder / "logs"
        self.folder.mkdir(parents=True)

    def url(self, key: str = "") -> Url:
        return Url("s3", "logs", key)


class _Handler(localbucket.S3Handler):  # type: ignore[misc]
    disable_nagle_algorithm = True

    def log_message(self, *arguments: object) -> None: ...

    def _write_object(self, bucket: str, key: str, write: Callable[[Any], str]) -> str:
        path: Path = self._object_path(bucket, key)
        expected = self.headers.get("If-Match")  # which localbucket knows only where it is read
        if expected is not None and not localbucket.etag_matches(expected, localbucket.object_etag(path)):
            raise self._precondition_failed_error()
        etag: str = super()._write_object(bucket, key, write)
        return etag


@contextlib.contextmanager
def serving_bucket(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    """Serve a bucket from `folder`; s3:// leads there as long as it runs, in this process and its children."""
    bucket = Bucket(folder)
    handler = type("Handler", (_Handler,), {"data_root": folder})
    with serving(handler) as server_port, bucket.before(server_port) as port:
        for name, value in {
            "AWS_ENDPOINT_URL_S3": f"http://127.0.0.1:{port}",
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
        }.items():
            monkeypatch.setenv(name, value)
        object_store.forget_stores()
        try:
            yield bucket
        finally:
            object_store.forget_stores()
