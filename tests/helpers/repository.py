"""Where this repository is."""

from __future__ import annotations

from pathlib import Path
from typing import Final

HELPERS: Final = Path(__file__).parent
ROOT: Final = HELPERS.parent.parent
