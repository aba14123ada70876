"""The command `bc-index`: builds the index, and prints its tables."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

import pyarrow.compute as pc

from common.command import FAILED, flags_given, warn
from common.errors import UsageError, counted, first_of
from common.files import session_name
from common.output import print_message, print_next, print_result, print_table
from common.ray_flag import tasks_of
from dataset.frames.frames_file import check_where
from dataset.frames.image_check_cache import check_all_images
from dataset.index.build import Indexed, build_index, check_settings
from dataset.index.index_report import balance_table, labels_table, print_log_notices, sessions_table
from dataset.index.leaks import find_leaks
from dataset.index.sessions import find_logs, sessions_beside
from dataset.parquet_file import read_columns
from dataset.samples.samples_format import SAMPLES_NAME

if TYPE_CHECKING:
    from dataset.cli import Index


def index(config: Index) -> int:
    _refuse_contradictions(config)
    logs = find_logs(config.sessions, config.folder)
    # first, before any file is written and before the slow steps
    check_settings(logs, config.index, config.config)
    # if the user named no sessions, a damaged log is skipped
    is_any = not config.sessions
    others = [] if is_any else sessions_beside(logs, config.folder)
    with tasks_of(config.ray) as tasks:
        if config.look:
            by_name = {session_name(log): log for log in logs}
            check_all_images(by_name, config.index, leave_out_unreadable=is_any, tasks=tasks)
        indexed = build_index(
            logs, config.index, config.config, leave_out_unreadable=is_any, passed_over=others, tasks=tasks
        )
    code = print_log_notices(indexed, config.folder, config.sessions)
    for notice in _one_sided(indexed, config):
        code = warn(notice)
    if others:  # training does not report them again
        print_message(
            f"{config.index}: does not hold {first_of(others)}; `bc-index` without names indexes all of"
            f" {config.folder}"
        )
    print_table(sessions_table(indexed))
    print_table(labels_table(indexed.labels))
    print_table(balance_table(indexed.balance))
    split = read_columns(config.index / SAMPLES_NAME, ["split"], read_dictionary=["split"])["split"]
    splits = {row["values"]: row["counts"] for row in pc.value_counts(split).to_pylist()}
    counts = ", ".join(f"{count:,} {split}" for split, count in sorted(splits.items()))
    frames = sum(session.frames for session in indexed.counts.values())
    print_result(f"{config.index}: {counted(frames, 'frame')}, {counted(len(split), 'sample')} ({counts})")
    if config.check:
        leaks = find_leaks(config.index)
        for leak in leaks:
            print_message(leak)
        print_result(counted(len(leaks), "leak") if leaks else "no leak between training and validation")
        code = FAILED if leaks else code
    if code != FAILED and any(count.training for count in indexed.counts.values()):
        flag = "" if config.index == type(config).index else f" --index {shlex.quote(str(config.index))}"
        print_next(f"bc-train{flag}")
    return code


def _refuse_contradictions(config: Index) -> None:
    """Raise UsageError for flags that contradict each other, and for a wrong condition."""
    of_blocks = ("validation_share", *["gap_s"] * (config.config.gap_s > 0))  # whole sessions have a gap of 0
    if config.config.validation and (flags := flags_given(config.config, *of_blocks)):
        raise UsageError(f"{flags}: not with --validation, which holds out whole sessions")
    if config.config.where is not None:
        check_where(config.config.where)


def _one_sided(indexed: Indexed, config: Index) -> list[str]:
    """A warning if training or validation has no samples, unless the settings say so."""
    counts = indexed.counts.values()
    if not any(count.training for count in counts):
        return [
            f"{config.index}: no sample for training: all frames are held out, in the gap, excluded, unusable, or"
            " without a label"
        ]
    if config.config.validation_share > 0 and not any(count.validation for count in counts):
        return [
            f"{config.index}: no sample for validation: the drives are too short; give a smaller --block-s, or"
            " hold out whole sessions with --validation SESSION"
        ]
    return []
