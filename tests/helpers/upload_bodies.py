"""Bodies of uploads as the page of imports sends them, and zips of any content."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence

from tests.helpers.workbench import Answer, Served

Content = Mapping[str, bytes]


def upload_body(files: Content | Sequence[tuple[str, bytes]]) -> tuple[bytes, int]:
    """The body, and the length of its manifest."""
    pairs = list(files.items()) if isinstance(files, Mapping) else list(files)
    manifest = json.dumps({"files": [[name, len(data)] for name, data in pairs]}).encode()
    return manifest + b"".join(data for _, data in pairs), len(manifest)


def zipped(files: Content, **info: int) -> bytes:
    """`info`: attributes of each member, such as external_attr."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            member = zipfile.ZipInfo(name)
            member.compress_type = zipfile.ZIP_DEFLATED
            for key, value in info.items():
                setattr(member, key, value)
            archive.writestr(member, data)
    return stream.getvalue()


def upload(bench: Served, files: Content | Sequence[tuple[str, bytes]]) -> Answer:
    body, manifest = upload_body(files)
    return bench.ask("POST", f"/import.upload?manifest={manifest}", body)
