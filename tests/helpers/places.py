"""Where a test's files lie: on the disk, and the same files in a bucket, for what is true of both."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import localbucket

from common.location import Location, Url
from faulty_proxy import serving

Place = Callable[[Path], Location]
"""How a command is told of a file that the test has written: by its path, or by its URL."""

KEYS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}


class Handler(localbucket.S3Handler):  # type: ignore[misc]
    """localbucket's, which tells nobody what it was asked; what of S3 it does not know is here: an object that is
    written on a condition, and the lists of uploads that are not finished, and of their parts."""

    disable_nagle_algorithm = True
    tells_checksums = True  # S3 does, if asked when the upload begins; not all that speak its protocol do
    wants_checksums = False  # of all parts, in the end, whether or not they were told

    def log_message(self, *arguments: object) -> None: ...

    def _write_object(self, bucket: str, key: str, write: Callable[[Any], str]) -> str:
        path: Path = self._object_path(bucket, key)
        expected = self.headers.get("If-Match")  # which localbucket knows only where it is read
        if expected is not None and not localbucket.etag_matches(expected, localbucket.object_etag(path)):
            raise self._precondition_failed_error()
        etag: str = super()._write_object(bucket, key, write)
        return etag

    def _get_request(self, bucket: str, key: str) -> None:
        if "uploads" in self.query:
            self._list_uploads(bucket)
        elif "uploadId" in self.query:
            self._list_parts(bucket, key)
        else:
            super()._get_request(bucket, key)

    def _complete_multipart_upload(self, bucket: str, key: str, body: bytes) -> None:
        if self.wants_checksums and body.count(b"<ChecksumSHA256>") < body.count(b"<PartNumber>"):
            raise localbucket.S3Error(HTTPStatus.BAD_REQUEST, "InvalidRequest", "the checksum is missing")
        super()._complete_multipart_upload(bucket, key, body)

    def _list_uploads(self, bucket: str) -> None:
        root = Element("ListMultipartUploadsResult", xmlns=localbucket.S3_NAMESPACE)
        SubElement(root, "IsTruncated").text = "false"
        folder: Path = self.data_root / localbucket.UPLOADS_DIR
        for about in sorted(folder.glob(f"*/{localbucket.UPLOAD_META}")):
            meta = json.loads(about.read_text())
            if meta["bucket"] == bucket and meta["key"].startswith(self.query.get("prefix", "")):
                upload = SubElement(root, "Upload")
                SubElement(upload, "Key").text = meta["key"]
                SubElement(upload, "UploadId").text = about.parent.name
                if self.tells_checksums:
                    SubElement(upload, "ChecksumAlgorithm").text = "SHA256"
        self._send_xml(root)

    def _list_parts(self, bucket: str, key: str) -> None:
        root = Element("ListPartsResult", xmlns=localbucket.S3_NAMESPACE)
        SubElement(root, "IsTruncated").text = "false"
        for path in sorted(self._upload_dir(bucket, key).glob("[0-9]*")):
            part = SubElement(root, "Part")
            SubElement(part, "PartNumber").text = str(int(path.name))
            SubElement(part, "ETag").text = f'"{localbucket.object_etag(path)}"'
            SubElement(part, "Size").text = str(path.stat().st_size)
            if self.tells_checksums:
                digest = hashlib.sha256(path.read_bytes()).digest()
                SubElement(part, "ChecksumSHA256").text = base64.b64encode(digest).decode()
        self._send_xml(root)


@contextlib.contextmanager
def as_bucket(folder: Path) -> Iterator[dict[str, str]]:
    """Serve a folder as a bucket of its name; gives the environment in which s3:// leads there."""
    with serving(type("Handler", (Handler,), {"data_root": folder.parent})) as port:
        yield {"AWS_ENDPOINT_URL_S3": f"http://127.0.0.1:{port}", **KEYS}


def url_within(folder: Path) -> Place:
    return lambda path: Url("s3", folder.name, path.relative_to(folder).as_posix())
