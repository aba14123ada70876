"""Logs made from other logs: their metadata, names and tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from common import Skipped
from common.files import refuse_existing
from common.versions import version_of
from recorder import topics
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.log.tags import Tag
from recorder.log.writer import LogWriter
from recorder.mcap.picture_places import is_about_places

LAST_ROW: Final = 2**32 - 1  # MCAP's sequence numbers have 32 bits


@dataclass(frozen=True)
class Written:
    path: Path
    messages: int
    rows: int
    skipped: Skipped
    notices: Sequence[str] = ()  # lines about missing or doubtful contents


def refuse_taken(to: Path, originals: Sequence[Path], overwrite: bool) -> None:
    """Raise UserError if `to` exists, and LogError if it is one of the originals, even with `overwrite`."""
    refuse_existing(to, overwrite)
    if to.exists() and any(path.exists() and to.samefile(path) for path in originals):
        raise LogError(f"{to}: is the log itself, which is not changed; give another name")


def new_log(log: Log, to: Path, session: dict[str, str], about: dict[str, str], overwrite: bool) -> LogWriter:
    """A new log made from `log`, with its metadata (`session`) and `about`. Copies of other programs' logs without
    metadata have none."""
    if not session and not log.is_ours:
        return LogWriter(to, None, overwrite=overwrite, profile="")
    rewritten = {"toolkit": "unknown", **session, "rewritten_by": version_of(), **about}
    return LogWriter(to, rewritten, overwrite=overwrite)


def copy_rest(
    log: Log, metadata: Sequence[tuple[str, dict[str, str]]], writer: LogWriter, skipped: Skipped
) -> None:
    """Copy attachments, and metadata that the new log does not write itself."""
    for name, values in metadata:
        if name not in (topics.SESSION_METADATA, topics.QUALITY_METADATA, topics.REWRITTEN_METADATA):
            writer.add_metadata(name, values)
    for offset in log.attachments:
        try:
            attachment = log.attachment(offset)
        except LogError:
            skipped.add("damaged attachments", f"at byte {offset:,}")
            continue
        if not is_about_places(attachment.name):  # `log.attachments` needs a summary to leave them out
            writer.copy_attachment(attachment)


def tags_of_rows(tags: Sequence[Tag], rows: Sequence[int]) -> list[Tag]:
    """The tags of these rows, clipped to the first and the last of the rows in each tag."""
    number = np.array(rows, np.int64)
    clipped = []
    for tag in tags:
        rows_within = number[(number >= tag.first_row) & (number <= tag.last_row)]
        if len(rows_within):
            clipped.append(Tag(int(rows_within.min()), int(rows_within.max()), tag.name))
    return clipped
