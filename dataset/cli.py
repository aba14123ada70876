"""`bc-index`: turns logs into frames and balanced samples."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from common.command import FAILED, flags_given, run_command, warn
from common.errors import UsageError, counted, first_of
from common.files import session_name
from common.location_flag import LocationFlag
from common.output import print_message, print_next, print_result, print_table
from common.ray_flag import RayAddress, tasks_of
from common.recipe import recipe_given
from dataset.config import IndexConfig

if TYPE_CHECKING:
    from dataset.index.build import Indexed


@dataclass(frozen=True)
class Index:
    """Build the index of the logs: frames and balanced samples, as parquet.

    Only changed sessions are read again. Without --look, no picture is decoded.

    bc-index
    bc-index lake mountain --where "speed_mph > 5"
    bc-index export --lerobot datasets/driving
    """

    RARE: ClassVar[str] = "ray"
    REMOVED: ClassVar[Mapping[str, str]] = {
        "--viewpoints": "bc-train alters every picture in every epoch instead",
        "--figures": "bc-web shows the balance; samples.parquet has the numbers",
    }
    sessions: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[SESSION ...]")] = ()
    """Names of sessions, or paths; by default all."""
    folder: Annotated[LocationFlag, tyro.conf.arg(name="sessions")] = Path("sessions")
    """Folder of the logs."""
    index: Path = Path("index")
    """Folder of the index."""
    look: bool = False
    """Decode all pictures; flag broken and frozen ones, and those that contradict the steering."""
    check: bool = False
    """Check the split for leaks; exit code 1 if there is one."""
    ray: RayAddress = None
    """Read the logs on a Ray cluster with shared folders."""
    config: tyro.conf.OmitArgPrefixes[IndexConfig] = field(default_factory=IndexConfig)


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
    from recorder.log_edit_cli import print_exported, refuse_no_text

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


def index(flags: Index) -> int:
    # NumPy, Arrow and OpenCV are slow to load: `--help` needs none
    import pyarrow.compute as pc

    from dataset.frames.image_check_cache import check_all_images
    from dataset.index.build import build_index, check_settings
    from dataset.index.index_report import balance_table, labels_table, print_log_notices, sessions_table
    from dataset.index.leaks import find_leaks
    from dataset.index.sessions import find_logs, sessions_beside
    from dataset.parquet_file import read_columns
    from dataset.samples.samples_format import SAMPLES_NAME

    _refuse_contradictions(flags)
    logs = find_logs(flags.sessions, flags.folder)
    # first, before any file is written and before the slow steps
    check_settings(logs, flags.index, flags.config)
    # if the user named no sessions, a damaged log is skipped
    is_any = not flags.sessions
    others = [] if is_any else sessions_beside(logs, flags.folder)
    with tasks_of(flags.ray) as tasks:
        if flags.look:
            by_name = {session_name(log): log for log in logs}
            check_all_images(by_name, flags.index, leave_out_unreadable=is_any, tasks=tasks)
        indexed = build_index(
            logs, flags.index, flags.config, leave_out_unreadable=is_any, passed_over=others, tasks=tasks
        )
    code = print_log_notices(indexed, flags.folder, flags.sessions)
    for notice in _one_sided(indexed, flags):
        code = warn(notice)
    if others:  # training does not report them again
        print_message(
            f"{flags.index}: does not hold {first_of(others)}; `bc-index` without names indexes all of"
            f" {flags.folder}"
        )
    print_table(sessions_table(indexed))
    print_table(labels_table(indexed.labels))
    print_table(balance_table(indexed.balance))
    split = read_columns(flags.index / SAMPLES_NAME, ["split"], read_dictionary=["split"])["split"]
    splits = {row["values"]: row["counts"] for row in pc.value_counts(split).to_pylist()}
    counts = ", ".join(f"{count:,} {split}" for split, count in sorted(splits.items()))
    frames = sum(session.frames for session in indexed.counts.values())
    print_result(f"{flags.index}: {counted(frames, 'frame')}, {counted(len(split), 'sample')} ({counts})")
    if flags.check:
        leaks = find_leaks(flags.index)
        for leak in leaks:
            print_message(leak)
        print_result(counted(len(leaks), "leak") if leaks else "no leak between training and validation")
        code = FAILED if leaks else code
    if code != FAILED and any(count.training for count in indexed.counts.values()):
        flag = "" if flags.index == type(flags).index else f" --index {shlex.quote(str(flags.index))}"
        print_next(f"bc-train{flag}")
    return code


def _refuse_contradictions(flags: Index) -> None:
    of_blocks = ("validation_share", *["gap_s"] * (flags.config.gap_s > 0))  # whole sessions have a gap of 0
    if flags.config.validation and (given := flags_given(flags.config, *of_blocks)):
        raise UsageError(f"{given}: not with --validation, which holds out whole sessions")
    if flags.config.where is not None:
        from dataset.frames.frames_file import check_where

        check_where(flags.config.where)


def _one_sided(indexed: Indexed, flags: Index) -> list[str]:
    """A warning if training or validation has no samples, unless the settings say so."""
    counts = indexed.counts.values()
    if not any(count.training for count in counts):
        return [
            f"{flags.index}: no sample for training: all frames are held out, in the gap, excluded, unusable, or"
            " without a label"
        ]
    if flags.config.validation_share > 0 and not any(count.validation for count in counts):
        return [
            f"{flags.index}: no sample for validation: the drives are too short; give a smaller --block-s, or"
            " hold out whole sessions with --validation SESSION"
        ]
    return []


def main() -> None:
    if sys.argv[1:2] == ["export"]:
        del sys.argv[1]
        run_command("bc-index export", ExportIndex, export)
    run_command("bc-index", Index, index, default=lambda: Index(config=IndexConfig.of(recipe_given())))
