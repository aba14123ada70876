"""The error if a path has no index, because it is misspelt or a file."""

from __future__ import annotations

import shlex
from pathlib import Path

from common.errors import did_you_mean, first_of
from dataset.errors import DatasetError
from dataset.samples.samples_format import SAMPLES_NAME


def missing_index(index: Path) -> DatasetError:
    """The error for a folder without an index: it names the indexes next to it, and the command that builds one.

    Raises DatasetError if the path or one of its parents is a file.
    """
    refuse_file(index)
    if kind := other_folder(index):
        raise DatasetError(
            f"{index}: {kind}, not an index; `bc-index --index FOLDER` builds an index in another folder"
        )
    folder = index.parent if index.parent.is_dir() else Path()
    neighbours = [str(samples.parent) for samples in sorted(folder.glob(f"*/{SAMPLES_NAME}"))]
    hint = did_you_mean(str(index), neighbours)
    if neighbours and not hint:
        hint = f"the indexes are {first_of(neighbours)};"
    flag = "" if index == Path("index") else f" --index {shlex.quote(str(index))}"
    return DatasetError(f"{index}: no index; {f'{hint} ' if hint else ''}build it with `bc-index{flag}`")


def other_folder(index: Path) -> str:
    """Returns "a run" or "a folder of logs" if the folder is one of these, and cannot become an index; else ""."""
    if (index / SAMPLES_NAME).exists():
        return ""
    if (index / "config.json").is_file():
        return "a run"
    return "a folder of logs" if next(index.glob("*.mcap"), None) else ""


def refuse_file(index: Path) -> None:
    for place in (index, *index.parents):
        if place.is_file():
            raise DatasetError(
                f"{place}: a file, not the folder of an index; `bc-index --index FOLDER` builds an index"
            )
