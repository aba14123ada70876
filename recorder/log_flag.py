"""Arguments of commands that take a log: its path, its URL, or the name of a session or drive of this folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Final, TypeAlias

from tyro.constructors import PrimitiveConstructorSpec

from common.errors import UserError
from common.location import Location, Url, local_path, location

SESSIONS: Final = Path("sessions")
FOLDERS: Final = (SESSIONS, Path("drives"))  # where logs are looked for by name


def named_log(place: Location) -> Location:
    """The log of a session or drive of this name, if there is one and `place` is no file itself; else `place`.

    Raises UserError for a name that a session and a drive have.
    """
    if isinstance(place, Url) or len(place.parts) != 1 or place.suffix in (".mcap", ".part"):
        return place
    if os.path.lexists(place):
        return place
    logs = [log for folder in FOLDERS if (log := folder / f"{place}.mcap").is_file()]
    if len(logs) > 1:
        raise UserError(f"{place}: {' and '.join(map(str, logs))} have this name; give one of them")
    return logs[0] if logs else place


LogFlag: TypeAlias = Annotated[
    Location,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="LOG",
        instance_from_str=lambda given: named_log(location(given[0])),
        is_instance=lambda value: isinstance(value, Path | Url),
        str_from_instance=lambda value: [str(value)],
    ),
]

LocalLogFlag: TypeAlias = Annotated[
    Path,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="LOG",
        instance_from_str=lambda given: local_path(named_log(location(given[0]))),
        is_instance=lambda value: isinstance(value, Path),
        str_from_instance=lambda value: [str(value)],
    ),
]
"""A log on this machine."""
