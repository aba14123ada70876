"""The libraries that the pages bring along are the files that their authors published."""

from __future__ import annotations

import hashlib
import re

from tests.helpers.repository import ROOT

FOLDER = ROOT / "web" / "static" / "vendor"


def test_each_is_the_published_file_and_has_its_licence() -> None:
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.]+)` \| .*, `([\w.]+)` \| `([0-9a-f]{64})` \|$", page, re.MULTILINE)
    files = {path.name for path in FOLDER.iterdir()} - {"README.md"}
    assert {name for row in rows for name in row[:2]} == files
    for name, _, checksum in rows:
        assert hashlib.sha256((FOLDER / name).read_bytes()).hexdigest() == checksum, name
