"""`bc-log export`: writes logs in another toolkit's format."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from common.command import warn_skipped
from common.errors import UsageError, counted
from common.output import print_message, print_next, print_result
from recorder.log_flag import LogFlag

if TYPE_CHECKING:
    from recorder.lerobot.export import Exported

UPLOADS: Final = "to publish it; nothing is uploaded yet"


@dataclass(frozen=True)
class ExportLogs:
    """Write logs as a LeRobot dataset (v3.0), one episode a drive, or a log as a recording of Udacity's simulator.

    Rows tagged `exclude` stay out.
    """

    logs: Annotated[tuple[LogFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to export."""
    lerobot: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """The new folder of the dataset."""
    udacity: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """The new folder of one log's driving_log.csv and IMG."""
    task: str = "Drive along the road."
    """The task in words, for networks that read it."""
    license: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Licence of the recordings, by its Hugging Face name, such as cc-by-4.0."""
    video: bool = False
    """Encode pictures as videos: a third smaller, but lossy."""

    def run(self) -> int:
        from recorder.lerobot.export import export_lerobot  # OpenCV and Arrow

        if not self.logs:
            raise UsageError("give at least 1 log, such as sessions/lake.mcap")
        if self.lerobot is None:
            return self._to_udacity()
        if self.udacity is not None:
            raise UsageError("give one of --lerobot FOLDER and --udacity FOLDER")
        refuse_no_text(("--task", self.task), ("--license", self.license))
        done = export_lerobot(self.logs, self.lerobot, task=self.task, licence=self.license, is_video=self.video)
        return print_exported(done, has_licence=self.license is not None, is_video=self.video)

    def _to_udacity(self) -> int:
        from recorder.upkeep.export_udacity import export_udacity

        if self.udacity is None or len(self.logs) != 1:
            raise UsageError("give --lerobot FOLDER, or one log and --udacity FOLDER")
        rows, skipped = export_udacity(self.logs[0], self.udacity)
        code = warn_skipped(skipped)
        print_result(f"{self.udacity}: {counted(rows, 'row')}")
        return code


def refuse_no_text(*flags: tuple[str, str | None]) -> None:
    """Raise UsageError if a given flag's value is not a line of text."""
    for name, text in flags:
        if text is not None and (not text.strip() or not text.isprintable()):
            raise UsageError(f"{name} {text!r}: expected a line of text")


def print_exported(done: Exported, *, has_licence: bool, is_video: bool) -> int:
    """Print what was written and what was not; the exit code."""
    code = warn_skipped(done.skipped)
    for notice in done.notices:
        print_message(notice)
    if done.excluded:
        print_message(f"{counted(done.excluded, 'row')} tagged exclude left out")
    if is_video:
        print_message("the videos are encoded anew: the original pictures are not in the dataset")
    if not has_licence:
        print_message(
            "no licence is stated: before you publish it, give --license, or write it into"
            f" {done.folder / 'README.md'}"
        )
    print_result(
        f"{done.folder}: {counted(done.episodes, 'episode')}, {counted(done.frames, 'frame')},"
        f" {counted(done.pictures, 'picture')}, {done.size_bytes / 1e6:,.1f} MB"
    )
    folder = done.folder
    print_next(f"hf upload {shlex.quote(folder.name)} {shlex.quote(str(folder))} --repo-type dataset", UPLOADS)
    return code
