"""Results of a study in files of JSON, so that a study can be stopped at any moment, and goes on."""

from __future__ import annotations

import json
from pathlib import Path

from common.files import atomic_file


def keep(path: Path, result: object) -> None:
    """Write the result of a step whole, or not at all."""
    path.parent.mkdir(exist_ok=True)
    with atomic_file(path, overwrite=True) as part:
        part.write_text(json.dumps(result))
