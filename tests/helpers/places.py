"""Where a test's files lie: on the disk, and the same files in a bucket, for what is true of both."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import localbucket

from common.location import Location, Url
from tests.helpers.faulty_proxy import serving

Place = Callable[[Path], Location]
"""How a command is told of a file that the test has written: by its path, or by its URL."""

KEYS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}


class Handler(localbucket.S3Handler):  # type: ignore[misc]
    """localbucket's, silent."""

    disable_nagle_algorithm = True

    def log_message(self, *arguments: object) -> None: ...


@contextlib.contextmanager
def as_bucket(folder: Path) -> Iterator[dict[str, str]]:
    """Serve a folder as a bucket of its name; gives the environment in which s3:// leads there."""
    with serving(type("Handler", (Handler,), {"data_root": folder.parent})) as port:
        yield {"AWS_ENDPOINT_URL_S3": f"http://127.0.0.1:{port}", **KEYS}


def url_within(folder: Path) -> Place:
    return lambda path: Url("s3", folder.name, path.relative_to(folder).as_posix())
