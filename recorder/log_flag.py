"""Arguments that name a log: its path, its URL, or the name of a session or drive in this folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Final, TypeAlias

from common.errors import UserError
from common.location import Location, Url, local_path, location
from common.location_flag import location_spec

SESSIONS: Final = Path("sessions")
FOLDERS: Final = (SESSIONS, Path("drives"))  # where logs are looked for by name


def named_log(place: Location, *, takes_folders: bool = False) -> Location:
    """The log of the session or drive named `place`, if there is one; `place` itself for other logs and files. A
    folder of this name comes first only with `takes_folders`.

    Raises UserError if a session and a drive have this name.
    """
    if isinstance(place, Url) or len(place.parts) != 1 or place.suffix in (".mcap", ".part"):
        return place
    if os.path.lexists(place) and (takes_folders or not place.is_dir()):
        return place
    logs = [log for folder in FOLDERS if (log := folder / f"{place}.mcap").is_file()]
    if len(logs) > 1:
        raise UserError(f"{place}: {' and '.join(map(str, logs))} have this name; give one of them")
    return logs[0] if logs else place


LogFlag: TypeAlias = Annotated[Path, location_spec("LOG", lambda text: local_path(named_log(location(text))))]
"""A log on this machine."""
LogOrUrlFlag: TypeAlias = Annotated[Location, location_spec("LOG", lambda text: named_log(location(text)))]
LogOrFolderFlag: TypeAlias = Annotated[
    Location, location_spec("LOG", lambda text: named_log(location(text), takes_folders=True))
]
