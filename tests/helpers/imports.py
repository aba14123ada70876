"""Imports of one format each, as tests call them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from recorder import Imported
from recorder.sources.import_recording import import_recording
from recorder.sources.settings import ImportSettings


def topics(image: str | None = None, steering: str | None = None, steering_scale: float = 1.0) -> ImportSettings:
    """What most tests say of another program's log."""
    return ImportSettings(image=image, steering=steering, steering_scale=steering_scale)


def import_csv(
    source: Path, log: Path, columns: Sequence[str], *, overwrite: bool = False, **printed: Any
) -> Imported:
    """`said`: fields of ImportSettings."""
    return import_recording(source, log, ImportSettings(columns=tuple(columns), **printed), overwrite=overwrite)
