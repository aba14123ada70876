"""Rows that a person finds bad while they are recorded: an event has them at once, and a tag in the end.

Tags are for one content of a log, which a growing one changes all the time. If its recording is killed, the tags
are made of the events when the log is recovered.
"""

from __future__ import annotations

import re
from typing import Final

from recorder.log.tags import EXCLUDE, Tag

_EVENT: Final = re.compile(r"driven badly: rows ([0-9]{1,9}) to ([0-9]{1,9})")


def driven_badly(first_row: int, last_row: int) -> str:
    """The text of the event."""
    return f"driven badly: rows {first_row} to {last_row}"


def bad_rows_in(event: str) -> Tag | None:
    """The tag of those rows; None for the text of another event."""
    matched = _EVENT.fullmatch(event)
    if matched is None or int(matched[1]) > int(matched[2]):
        return None
    return Tag(int(matched[1]), int(matched[2]), EXCLUDE)
