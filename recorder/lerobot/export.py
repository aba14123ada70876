"""Exports logs as a LeRobot dataset: a folder that appears whole or not at all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common import Skipped, UserError
from common.car import CAMERAS, Camera
from common.files import new_folder
from common.location import Location
from common.progress import Advance, progress_bar, progress_task
from recorder.errors import LogError
from recorder.lerobot import dataset_format as form
from recorder.lerobot.dataset_files import (
    CARD_PATH,
    CardSession,
    DatasetFiles,
    card,
    video_info,
    write_json,
    write_tasks,
)
from recorder.lerobot.dataset_format import ExportPlan, plan_export
from recorder.lerobot.feature_statistics import (
    PictureStatistics,
    Statistics,
    as_json,
    combined,
    number_statistics,
    sampled,
)
from recorder.lerobot.log_episodes import ChosenRows, LogEpisodes, RowPictures, Sizes, log_episodes
from recorder.log.meant_gaps import NotRecorded
from recorder.log.reader import Log
from recorder.log.session_car import CAR_KEY, Car, known_max_steering_deg, metadata_of, stored_car
from recorder.pictures.picture_size import PNG_START
from recorder.rows.row_quality import States
from recorder.topics import EVENTS

TASK: Final = "Drive along the road."
_WRITTEN_BYTES: Final = 1 << 26  # bytes of pictures in a row group

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Exported:
    """A new dataset, and the parts of its logs that are not in it."""

    folder: Path
    episodes: int
    frames: int
    pictures: int
    size_bytes: int
    excluded: int
    """Rows tagged `exclude`."""
    skipped: Skipped
    notices: Sequence[str]


def export_lerobot(
    paths: Sequence[Location],
    folder: Path,
    *,
    task: str = TASK,
    licence: str | None = None,
    is_video: bool = False,
    chosen: Mapping[Location, ChosenRows] | None = None,
    cameras: Sequence[Camera] = CAMERAS,
) -> Exported:
    """Write the logs at `paths` as the new LeRobot dataset `folder`, an episode for each drive.

    `chosen`: only these rows of each log, with their sides of a split. `cameras`: used if every log has them.
    Pictures are in the parquet files byte for byte or, with `is_video`, encoded anew in videos. Raises LogError if
    a log cannot be read or nothing can be used, and UserError if `folder` exists or cannot be written.
    """
    with new_folder(folder) as part, _refused(folder):
        plan = plan_export(paths, chosen, cameras)
        with (
            DatasetFiles(part, plan, is_video=is_video, has_split=chosen is not None) as files,
            progress_bar() as bar,
            progress_task(bar, f"exporting to {folder.name}", plan.rows) as advance,
        ):
            export = _Export(plan, files, task, advance)
            for path in paths:
                with Log(path) as log:
                    export.add(log, None if chosen is None else chosen[path])
        if not export.episodes:
            raise LogError(f"{', '.join(map(str, paths))}: no row can be exported{export.skipped.error_suffix()}")
        export.write_rest(licence)
        size_bytes = sum(path.stat().st_size for path in part.rglob("*") if path.is_file())
    return Exported(
        folder,
        export.episodes,
        export.frames,
        export.frames * len(plan.cameras),
        size_bytes,
        sum(session.excluded for session in export.sessions),
        export.skipped,
        plan.notices,
    )


class _Export:
    """The episodes written until now, and their statistics."""

    def __init__(self, plan: ExportPlan, files: DatasetFiles, task: str, advance: Advance) -> None:
        self._plan, self._files, self._task, self._advance = plan, files, task, advance
        self.skipped = Skipped()
        self.episodes = self.frames = 0
        self.sessions: list[CardSession] = []
        self._sizes = Sizes()
        self._statistics: list[dict[str, Statistics]] = []  # of each episode
        self._example = b""

    def add(self, log: Log, chosen: ChosenRows | None = None) -> None:
        """Write the episodes of a log, or of its `chosen` rows. Raises LogError for a damaged log."""
        if log.notice:
            self.skipped.add("parts of logs that are not finished", log.notice)
        taken = log_episodes(log, self._plan.cameras, self.skipped, chosen)
        frames_before, episodes_before = self.frames, self.episodes
        left_out = _left_out(log)
        pictures = RowPictures(log, taken, self._sizes, self.skipped)
        for episode in taken.episodes:
            self._add_episode(log, taken, range(episode.start, episode.stop), pictures, left_out)
        rows, episodes = self.frames - frames_before, self.episodes - episodes_before
        self.sessions.append(
            CardSession(_name(log), log.fingerprint, log.metadata, rows, episodes, taken.excluded)
        )

    def _add_episode(
        self,
        log: Log,
        taken: LogEpisodes,
        rows: range,
        pictures: RowPictures,
        left_out: Mapping[int, tuple[float, str]],
    ) -> None:
        is_video = self._files.is_video
        of_pictures = {camera: PictureStatistics() for camera in self._plan.cameras}
        sampled_rows = set((sampled(len(rows)) + rows.start).tolist())
        kept: list[int] = []  # rows with usable pictures
        waiting: list[list[bytes]] = []  # pictures of the last kept rows, not written yet
        waiting_bytes = 0
        for number in rows:
            self._advance(1)
            # an episode with unusable first pictures needs a sample, too
            is_sampled = number in sampled_rows or not kept
            encoded = pictures.read(number)
            decoded = pictures.decode(number, encoded) if encoded and (is_video or is_sampled) else []
            if encoded is None or decoded is None:
                continue
            if not kept:
                self._files.begin_episode(self._sizes, len(rows), taken.pictures_bytes(rows))
                self._example = self._example or encoded[0]
            if is_sampled:
                for of_camera, picture in zip(of_pictures.values(), decoded, strict=True):
                    of_camera.add(picture)
            if is_video:
                self._files.add_to_videos(decoded)
            kept.append(number)
            waiting.append(encoded)
            waiting_bytes += sum(map(len, encoded))
            if waiting_bytes >= _WRITTEN_BYTES:
                self._write(log, taken, kept, waiting)
                waiting, waiting_bytes = [], 0
        if not kept:
            return
        if waiting:
            self._write(log, taken, kept, waiting)
        statistics = _statistics(self._numbers(taken, kept), of_pictures)
        about = self._about(log, statistics, len(kept))
        seconds, why = left_out.get(int(taken.states.time_ns[kept[0]]), (0.0, ""))
        about |= {form.LOG_NOT_RECORDED_S: seconds, form.LOG_NOT_RECORDED: why}
        if taken.split is not None:
            about[form.SPLIT] = str(taken.split[kept[0]])
        self._files.end_episode(about)
        self._statistics.append(statistics)
        self.episodes += 1
        self.frames += len(kept)

    def _write(self, log: Log, taken: LogEpisodes, kept: list[int], pictures: list[list[bytes]]) -> None:
        """Write the last of an episode's rows with their pictures."""
        count = len(pictures)
        numbers = self._numbers(taken, kept)
        columns = {name: _arrow(values[-count:]) for name, values in numbers.items()}
        columns[form.LOG_FINGERPRINT] = pa.array([log.fingerprint] * count)
        if not self._files.is_video:
            of_cameras = zip(*pictures, strict=True)
            columns |= {
                form.image_key(camera): pa.StructArray.from_arrays(
                    [pa.array(of_camera, pa.binary()), pa.nulls(count, pa.string())], fields=list(form.IMAGE_TYPE)
                )
                for camera, of_camera in zip(self._plan.cameras, of_cameras, strict=True)
            }
        if taken.split is not None:
            columns[form.SPLIT] = pa.array(taken.split[kept[-count:]])
        self._files.write(columns)

    def _numbers(self, taken: LogEpisodes, kept: list[int]) -> Columns:
        states = taken.states.part(kept)
        frame = np.arange(len(kept))
        vehicle = np.stack([states.steering, states.throttle, states.brake, states.speed_mph], axis=1)
        speed = [states.speed_mph] if self._plan.has_speed else []
        return {
            form.STATE: np.column_stack([*speed, taken.previous[kept]]).astype(np.float32),
            form.ACTION: vehicle[:, :3].astype(np.float32),
            "timestamp": (frame / self._plan.fps).astype(np.float32),
            "frame_index": frame,
            "episode_index": np.full(len(kept), self.episodes),
            "index": frame + self.frames,
            "task_index": np.zeros(len(kept), np.int64),
            form.LOG_TIME: states.time_ns,
            form.LOG_ROW: states.row,
            form.LOG_VEHICLE: vehicle,
        }

    def _about(self, log: Log, statistics: dict[str, Statistics], frames: int) -> dict[str, Any]:
        return {
            "episode_index": self.episodes,
            "tasks": [self._task],
            "length": frames,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + frames,
            "log_name": _name(log),
            form.LOG_CAR: _car(log),
            **{
                f"stats/{feature}/{name}": values
                for feature, columns in as_json(statistics).items()
                for name, values in columns.items()
            },
        }

    def write_rest(self, licence: str | None) -> None:
        plan, root, is_video = self._plan, self._files.root, self._files.is_video
        info = form.info(
            self._files.columns, fps=plan.fps, episodes=self.episodes, frames=self.frames, is_video=is_video
        )
        if is_video:
            for camera, size in self._sizes.items():
                info["features"][form.image_key(camera)]["info"] = video_info(plan.fps, size)
        write_json(root / form.INFO_PATH, info)
        write_json(root / form.STATS_PATH, as_json(combined(self._statistics)))
        write_tasks(root, self._task)
        picture = "picture.png" if self._example.startswith(PNG_START) else "picture.jpg"
        (root / picture).write_bytes(self._example)
        text = card(info, self.sessions, plan, task=self._task, licence=licence, picture=picture)
        (root / CARD_PATH).write_text(text, encoding="utf-8")


def _statistics(numbers: Columns, pictures: dict[Camera, PictureStatistics]) -> dict[str, Statistics]:
    """Statistics of an episode, without our own columns: nothing learns from them, and a speed may be NaN."""
    of_pictures = {form.image_key(camera): statistics.statistics() for camera, statistics in pictures.items()}
    own = {form.LOG_TIME, form.LOG_ROW, form.LOG_VEHICLE}
    return of_pictures | {name: number_statistics(values) for name, values in numbers.items() if name not in own}


def _arrow(values: NDArray[Any]) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _car(log: Log) -> str:
    """The car of a log as JSON; empty if unknown."""
    car = stored_car(log)
    if car is None and (degrees := known_max_steering_deg(log)) is not None:
        car = Car(max_steering_deg=degrees)
    return metadata_of(car).get(CAR_KEY, "")


def _left_out(log: Log) -> dict[int, tuple[float, str]]:
    """The seconds left out on purpose before a row, and their event, by the row's log time."""
    states = States.of(log.vehicle())
    seconds = NotRecorded.of(log).seconds(states)
    events = {at.log_time_ns: event.message for at, event in log.decoded(EVENTS)} if EVENTS in log.counts else {}
    return {
        time_ns: (left_out_s, events.get(time_ns, ""))
        for time_ns, left_out_s in zip(states.time_ns.tolist(), seconds.tolist(), strict=True)
        if left_out_s
    }


def _name(log: Log) -> str:
    return log.path.name.removesuffix(".mcap")


@contextlib.contextmanager
def _refused(folder: Path) -> Iterator[None]:
    """Turn errors of a full or failing disk into one line."""
    try:
        yield
    except (OSError, pa.ArrowException) as error:
        why = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise UserError(f"{folder}: cannot be written ({why}); nothing was kept of it") from None
