"""`bc-index export`: writes the frames that an index uses in the format of another toolkit."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.command import run_command
from recorder.log_edit_cli import print_exported, refuse_no_text


@dataclass(frozen=True)
class ExportIndex:
    """Write the rows that the index uses as a LeRobot dataset (v3.0), with the split of each row."""

    lerobot: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """The new folder of the dataset."""
    index: Path = Path("index")
    """The index."""
    where: Annotated[str | None, tyro.conf.arg(metavar="CONDITION")] = None
    """Only rows that meet this condition on the index's columns."""
    task: str = "Drive along the road."
    """The task in words, for networks that read it."""
    license: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Licence of the recordings, by its Hugging Face name, such as cc-by-4.0."""
    video: bool = False
    """Encode pictures as videos: a third smaller, but lossy."""


def export(config: ExportIndex) -> int:
    from dataset.frames.frames_file import check_where
    from dataset.index_export import export_index

    refuse_no_text(("--task", config.task), ("--license", config.license))
    if config.where is not None:
        check_where(config.where)
    done = export_index(
        config.index,
        config.lerobot,
        where=config.where,
        task=config.task,
        licence=config.license,
        is_video=config.video,
    )
    return print_exported(done, has_licence=config.license is not None, is_video=config.video)


def main() -> None:
    """Run `bc-index export`: `sys.argv` begins with the first argument, `export`."""
    del sys.argv[1]
    run_command("bc-index export", ExportIndex, export)
