"""Export the frames that an index uses as a LeRobot dataset."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from common import UserError
from common.errors import UsageError
from dataset.errors import DatasetError
from dataset.frames.frames_file import check_where, read_frames
from dataset.index.build_state import FRAMES_FOLDER
from dataset.samples.sample_choice import choose_frames
from dataset.samples.samples_format import SessionLabels
from dataset.samples.samples_reader import Samples
from recorder.lerobot.export import Exported, export_lerobot
from recorder.lerobot.log_episodes import ChosenRows
from recorder.rows.condition import rows_where


def export_index(index: Path, folder: Path, *, where: str | None = None, **options: Any) -> Exported:
    """Write the rows that `index` uses as the new LeRobot dataset `folder`, each with its `split`.

    A row is used if settings, tags and flags leave at least one of its frames in the index (before balancing).
    With `where`, one of these frames must also meet the condition. The steering is the recorded one, not the
    label. `options` are those of `export_lerobot`.

    Raises DatasetError if the index is missing or does not fit its logs, UsageError if the condition is wrong,
    LogError if nothing can be exported, UserError if no row is used, or if `folder` exists or cannot be written.
    """
    with Samples(index) as samples:
        chosen = _chosen_rows(index, samples, where)
        logs = {session: log.path for session, log in samples.logs.items() if len(chosen[session].row)}
        if not logs:
            raise UserError(
                f"{index}: {'no row is used' if where is None else f'no used row meets --where {where!r}'}"
            )
        cameras = samples.settings.cameras
    by_path = {path: chosen[session] for session, path in logs.items()}
    return export_lerobot(list(by_path), folder, chosen=by_path, cameras=cameras, **options)


def _chosen_rows(index: Path, samples: Samples, where: str | None) -> Mapping[str, ChosenRows]:
    config = samples.settings
    if config.where is not None:
        try:
            check_where(config.where)
        except UsageError as error:  # of an earlier version, which took SQL
            raise DatasetError(f"{index}: made with {error}; run `bc-index` again") from None
    chosen: dict[str, ChosenRows] = {}
    for session in samples.sources:
        try:
            labels = msgspec.convert(samples.metadata["labels"][session], SessionLabels)
        except (KeyError, TypeError, msgspec.ValidationError):
            raise DatasetError(
                f"{samples.path}: lacks the label plan of session {session}; run `bc-index` again"
            ) from None
        frames = read_frames(index / FRAMES_FOLDER / f"{session}.parquet")
        choice = choose_frames(frames, config, labels)
        is_used = choice.is_chosen if where is None else choice.is_chosen & rows_where(frames, where)
        row, first = np.unique(frames["row"].to_numpy()[is_used], return_index=True)
        chosen[session] = ChosenRows(row, np.where(choice.is_training[is_used][first], "train", "validation"))
    return chosen
