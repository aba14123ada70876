"""Text files that another program writes anew while they are read."""

from __future__ import annotations

from recorder.sources.udacity_recording import CsvTail

WAYS = ["written anew", "another file", "deleted first"]


def begin_again(tail: CsvTail, text: bytes, way: str) -> None:
    """Give the file that `tail` reads other contents, in one of WAYS."""
    path = tail.path
    if way == "another file":
        other = path.with_name("other")
        other.write_bytes(text)
        other.replace(path)
        return
    if way == "deleted first":
        path.unlink()
        assert tail.new_lines() == []
    path.write_bytes(text)
