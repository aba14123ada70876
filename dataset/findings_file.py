"""Findings in a log that took long to make, kept beside an index as one JSON file a session.

It may be damaged, or somebody else's: then there are no findings, and they are made again.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

import msgspec

from common import atomic_file
from dataset.errors import index_write_errors

Findings = TypeVar("Findings", bound=msgspec.Struct)


def write_findings(path: Path, findings: msgspec.Struct) -> None:
    """Replace the file in one step. Raises DatasetError if the disk is full."""
    with index_write_errors(path), atomic_file(path, overwrite=True) as part:
        part.write_text(json.dumps(msgspec.to_builtins(findings)) + "\n", encoding="utf-8")


def read_findings(path: Path, kind: type[Findings], max_bytes: int) -> Findings | None:
    """The findings in the file; None if there is none, or it is a link, larger than `max_bytes`, or damaged."""
    try:
        if path.is_symlink() or path.stat().st_size > max_bytes:
            return None
        return msgspec.convert(json.loads(path.read_bytes()), kind)
    except (OSError, ValueError, RecursionError):
        return None
