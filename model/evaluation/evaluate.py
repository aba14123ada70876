"""Evaluation of a trained network on frames of an index or of whole sessions.

bc-eval RUN
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common import Skipped
from common.car import MAX_STEERING_DEG
from common.errors import counted
from common.location import Location, absolute, location
from dataset import DatasetError, IndexConfig, Loader, Samples, build_index
from dataset.frames.distinct_rows import by_session
from dataset.frames.frames_table import in_crashes, is_for_training
from dataset.index.sessions import by_session_name
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import STEERING_ONLY, TARGETS, TargetName, steering_in
from dataset.preprocessing import Image
from dataset.samples.samples_reader import Split
from model.evaluation.predict import BATCH, predict_crops
from model.metrics import (
    Errors,
    Measures,
    ReactionTime,
    TargetErrors,
    errors,
    measure,
    reaction_time,
    target_errors,
)
from model.runs.answer_scale import AnswerScale
from model.runs.car_of_run import refuse_other_steering
from model.runs.enough_to_drive import Hand
from model.runs.run_files import without_nan
from model.runs.run_folder import load_answer_scale, load_config, run_name, speed_ahead_s_of_run, targets_of_run
from model.runs.run_numbers import index_of_config

_FROM_INDEX: Final = pa.schema(
    [
        ("session", pa.string()),
        ("row", pa.int64()),
        ("camera", pa.string()),
        ("log_time_ns", pa.int64()),
        ("recorded", pa.float64()),
    ]
)


@dataclass(frozen=True)
class Evaluation:
    """Predictions of a run's network for some frames, and their errors."""

    run: Path
    frames: pa.Table
    """session, row, camera, log_time_ns, crash; recorded and predicted: steering, -1..1; recorded_NAME and
    predicted_NAME: other targets, in their unit."""
    logs: Mapping[str, Location]  # by session
    begins_ns: dict[str, int]  # log time of the first message, by session
    trained_on: int | None  # frames that the run was trained on; None if its config does not record it
    skipped: Skipped  # pictures that do not decode
    notices: tuple[str, ...] = ()  # unfinished logs, logs and targets that are not measured; the same for all runs
    remarks: tuple[str, ...] = ()  # logs in which damage cannot be detected, or that are slow to read from a store
    answers: AnswerScale = field(default_factory=AnswerScale)  # applied to the predictions
    targets: tuple[TargetName, ...] = STEERING_ONLY  # that the network answers and the frames have
    max_deg: float | None = MAX_STEERING_DEG  # the wheels' angle at steering 1; None: unknown
    hands: Mapping[str, Hand] = field(default_factory=dict)  # how sessions were steered, if known

    @cached_property
    def measures(self) -> Measures:
        return self._measure(self.frames)

    @cached_property
    def other_targets(self) -> tuple[TargetErrors, ...]:
        return tuple(
            target_errors(name, *(self.frames[column].to_numpy() for column in target_columns(name)))
            for name in self.targets[1:]
        )

    @cached_property
    def crashes(self) -> int:
        """The number of frames in crashes, where the steering does not follow the road."""
        return int(pc.sum(self.frames["crash"]).as_py() or 0)

    @cached_property
    def driving(self) -> Evaluation:
        """The evaluation of the frames outside crashes, which the verdict uses; this evaluation itself if no frame
        or every frame is of a crash."""
        outside = self.frames.filter(pc.invert(self.frames["crash"]))
        return replace(self, frames=outside) if self._is_mixed else self

    @property
    def _is_mixed(self) -> bool:
        return 0 < self.crashes < len(self.frames)

    @property
    def without_crashes(self) -> Measures | None:
        """The measures outside crashes; None if no frame or every frame is of a crash."""
        return self.driving.measures if self._is_mixed else None

    @cached_property
    def as_learnt(self) -> Errors:
        """The errors of the network's answers as learnt, without their scale."""
        learnt = self.answers.learnt(self.frames["predicted"].to_numpy())
        return errors(learnt, self.frames["recorded"].to_numpy(), self.max_deg)

    @cached_property
    def reaction_time(self) -> ReactionTime | None:
        """None also if a session was steered smoothly: its steering is alike at many delays."""
        is_smooth = "smooth" in [self.hands.get(session) for session in self.sessions]
        return None if is_smooth else reaction_time(self.frames)

    @cached_property
    def sessions(self) -> dict[str, Measures]:
        """The measures of each session with measured frames."""
        return {session: self._measure(part) for session, part in by_session(self.frames)}

    @cached_property
    def balanced_rmse_deg(self) -> dict[str, float]:
        """The balanced RMSE of the network, of always predicting zero, and of always predicting the mean."""
        recorded = self.frames["recorded"].to_numpy()
        zero = measure(np.zeros(len(recorded)), recorded, max_deg=self.max_deg)
        mean_deg = self.measures.mean_balanced_rmse_deg
        return {"network": self.measures.balanced_rmse_deg, "zero": zero.balanced_rmse_deg, "mean": mean_deg}

    def _measure(self, frames: pa.Table) -> Measures:
        return measure(frames["predicted"].to_numpy(), frames["recorded"].to_numpy(), max_deg=self.max_deg)

    def as_dict(self) -> dict[str, Any]:
        """For JSON, with the names of metrics.jsonl; None in place of NaN."""
        whole = _as_dict(self.measures)
        targets = [without_nan(target.as_dict()) for target in self.other_targets]
        whole["zero"]["balanced_rmse_deg"] = self.balanced_rmse_deg["zero"]
        return {
            "run": run_name(self.run),
            "learnt": self.trained_on,
            **({"max_deg": None} if self.max_deg is None else {}),
            "skipped": dict(self.skipped.counts),
            **whole,
            "answers": asdict(self.answers),
            "as_learnt": without_nan(asdict(self.as_learnt)),
            "reaction_time": asdict(self.reaction_time) if self.reaction_time else None,
            **({"targets": targets} if targets else {}),
            "crashes": self.crashes,
            "without_crashes": _as_dict(self.without_crashes) if self.without_crashes else None,
            "sessions": {
                session: {"log": str(self.logs[session]), **_as_dict(measures)}
                for session, measures in self.sessions.items()
            },
        }


def target_columns(target: TargetName) -> tuple[str, str]:
    """The names of the columns with the predicted and the recorded values of a target other than steering."""
    name = TARGETS[target].answer_name
    return f"predicted_{name}", f"recorded_{name}"


def evaluate(run: Path | str, index: Path | str, split: Split = "validation") -> Evaluation:
    """Measure a run on a split of `index`: its answers to the centre camera's unaltered pictures, against the
    recorded steering.

    Raises RunError if the run is incomplete or damaged, DatasetError if the index is damaged or the split is
    empty, LogError for a damaged log.
    """
    (evaluation,) = evaluate_runs([run], index, split)
    return evaluation


def evaluate_runs(runs: Sequence[Path | str], index: Path | str, split: Split = "validation") -> list[Evaluation]:
    """`evaluate` for several runs at once, on the same frames. Each picture is decoded once."""
    with Samples(index) as samples:
        view = samples.driving_view(split)
        if not len(view):
            raise DatasetError(
                f"{samples.path}: no frame of the split {split} in it; give another --split, or whole sessions:"
                " --session NAME"
            )
        return _evaluate([Path(run) for run in runs], samples, view)


def evaluate_sessions(run: Path | str, logs: Sequence[Location | str]) -> Evaluation:
    """Measure a run on all usable frames of some logs, which need not be in an index.

    Raises RunError if the run is incomplete or damaged, LogError or DatasetError if a log is.
    """
    (evaluation,) = evaluate_runs_on_sessions([run], logs)
    return evaluation


def evaluate_runs_on_sessions(runs: Sequence[Path | str], logs: Sequence[Location | str]) -> list[Evaluation]:
    """`evaluate_sessions` for several runs at once, on the same frames. Each picture is decoded once."""
    paths = by_session_name(map(location, logs))
    ahead_s = [speed_ahead_s_of_run(Path(run)) for run in runs if "speed" in targets_of_run(Path(run))]
    config = IndexConfig(
        validation=tuple(paths),
        balance=False,
        flip=False,
        labels="as-recorded",
        speed_ahead_s=ahead_s[0] if ahead_s else 0.0,
    )
    with tempfile.TemporaryDirectory(prefix="bc-eval-") as folder:
        indexed = build_index(list(paths.values()), Path(folder), config)
        evaluations = evaluate_runs(runs, folder)
    notices = [*evaluations[0].notices, *indexed.notices] + [
        f"{path}: not measured: it has no usable picture of the centre camera"
        for session, path in paths.items()
        if session not in evaluations[0].sessions
    ]
    remarks = tuple(indexed.remarks)
    return [replace(measured, logs=paths, notices=tuple(notices), remarks=remarks) for measured in evaluations]


def _evaluate(runs: Sequence[Path], samples: Samples, view: pa.Table) -> list[Evaluation]:
    configs = [load_config(run) for run in runs]
    for run in runs:
        refuse_other_steering(run, samples.max_steering_deg, str(samples.path))
    loaders: list[Loader] = []

    def batches(picture: PictureSpec) -> Iterable[tuple[NDArray[np.int64], Image]]:
        # without a budget for decoded pictures: each picture is used once
        loaders.append(Loader(samples, view, batch=BATCH, budget_bytes=0, seen=picture))
        return loaders[-1].crops(np.arange(len(view)))

    answers, is_decoded = predict_crops(runs, batches, len(view))
    skipped = loaders[0].skipped  # the same for each network
    if not is_decoded.any():
        _, name = next(iter(skipped))
        raise DatasetError(
            f"none of {counted(len(view), 'picture')} decodes, for example {name}; look with `bc-log check`"
        )
    frames = _from_index(view, samples)
    frames = frames.append_column("crash", pa.array(_in_crashes(frames, samples)))
    sessions = dict(by_session(frames.filter(pa.array(is_decoded))))
    labels_of_sessions = index_of_config({"data": samples.metadata}).labels
    hands = {name: of_session.hand for name, of_session in labels_of_sessions.items() if of_session.hand}
    unmeasured = [_unmeasured(run, samples) for run in runs]
    notices = tuple(dict.fromkeys(notice for of_run in unmeasured for notice in of_run.values()))
    labels = [
        {name: samples.target_labels(view, name) for name in targets_of_run(run)[1:] if name not in left_out}
        for run, left_out in zip(runs, unmeasured, strict=True)
    ]
    return [
        Evaluation(
            run,
            _with_answers(frames, recorded, predicted, targets_of_run(run)).filter(pa.array(is_decoded)),
            {session: absolute(log.path) for session, log in samples.logs.items()},
            {session: log.time_range_ns[0] for session, log in samples.logs.items()},
            count_trained_on(sessions, samples, config),
            skipped,
            notices,
            answers=load_answer_scale(run),
            targets=(*STEERING_ONLY, *recorded),
            max_deg=samples.max_steering_deg,
            hands=hands,
        )
        for run, predicted, config, recorded in zip(runs, answers, configs, labels, strict=True)
    ]


def _unmeasured(run: Path, samples: Samples) -> dict[TargetName, str]:
    """The targets of a run that cannot be measured on these samples, with the reasons."""
    targets = targets_of_run(run)
    reasons = {
        name: f"{samples.path}: has no labels of {name}, so it is not measured; run `bc-index` again"
        for name in samples.missing(targets)
    }
    answered_s, recorded_s = speed_ahead_s_of_run(run), samples.speed_ahead_s
    if "speed" in targets and "speed" not in reasons and answered_s != recorded_s:
        reasons["speed"] = (
            f"{run}: its speed is not measured: it answers the speed {answered_s:g} s ahead, and the labels have"
            f" the speed {recorded_s:g} s ahead; measure it separately, with --session or an index of `bc-index"
            f" --speed-ahead {answered_s:g}`"
        )
    return reasons


def _with_answers(
    frames: pa.Table,
    recorded: Mapping[TargetName, NDArray[np.float64]],
    answers: NDArray[np.float64],
    targets: Sequence[TargetName],
) -> pa.Table:
    """The frames with a network's answers for `targets`, (N,) or (N, K), and with the `recorded` values of the
    other measured targets, (N,) each."""
    frames = frames.append_column("predicted", pa.array(steering_in(answers)))
    for name, labels in recorded.items():
        predicted_column, recorded_column = target_columns(name)
        predicted = answers[:, targets.index(name)] * TARGETS[name].per_unit
        frames = frames.append_column(predicted_column, pa.array(predicted))
        frames = frames.append_column(recorded_column, pa.array(labels))
    return frames


def _from_index(view: pa.Table, samples: Samples) -> pa.Table:
    """The columns of `_FROM_INDEX`. Raises DatasetError if one is missing, has nulls or has another type."""
    try:
        frames = view.select(_FROM_INDEX.names).cast(_FROM_INDEX)
        is_damaged = any(column.null_count for column in frames.columns)
    except (KeyError, ValueError, pa.ArrowException):
        is_damaged = True
    if is_damaged:
        raise DatasetError(f"{samples.path}: damaged; remove it and run `bc-index`")
    return frames


def _in_crashes(frames: pa.Table, samples: Samples) -> NDArray[np.bool_]:
    crash = np.zeros(len(frames), np.bool_)
    session = frames["session"].combine_chunks().dictionary_encode()
    for number, name in enumerate(session.dictionary.to_pylist()):
        at = np.flatnonzero(session.indices.to_numpy() == number)
        crash[at] = in_crashes(frames.take(pa.array(at)), samples.logs[name])
    return crash


def _as_dict(measures: Measures) -> dict[str, Any]:
    return {
        "frames": measures.frames,
        "network": without_nan(asdict(measures.network)),
        "zero": without_nan(asdict(measures.zero)),
        "mean": without_nan({**asdict(measures.mean), "balanced_rmse_deg": measures.mean_balanced_rmse_deg}),
        "balanced_rmse_deg": measures.balanced_rmse_deg,
        "bins": [asdict(part) for part in measures.bins],
    }


def count_trained_on(frames: Mapping[str, pa.Table], samples: Samples, config: dict[str, Any]) -> int | None:
    """The number of `frames` that the run with this config was trained on; None if the config does not record it.

    `frames` has a table for each session of `samples`, with the columns row and log_time_ns. Raises LogError for a
    damaged log.
    """
    try:
        started_from = config["init"]["data"] if "init" in config else []
        trainings = [_training_data(data) for data in (config["data"], *started_from)]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return None
    count = 0
    for session, part in frames.items():
        is_learnt = np.zeros(len(part), np.bool_)
        for index_config, names in trainings:
            for name in names.get(samples.sources[session].fingerprint, ()):
                is_learnt |= is_for_training(part, samples.logs[session], name, index_config)
        count += int(is_learnt.sum())
    return count


def _training_data(stored: dict[str, Any]) -> tuple[IndexConfig, dict[str, list[str]]]:
    """The settings of the split of a training, and its sessions by the fingerprint of their log. Raises KeyError,
    TypeError, ValueError, AttributeError or OverflowError for invalid data."""
    # Not by `settings_from`, which would refuse the unknown settings of other versions.
    settings = stored["settings"]
    config = IndexConfig(
        block_s=float(settings["block_s"]),
        gap_s=float(settings["gap_s"]),
        validation_share=float(settings["validation_share"]),
        validation=tuple(map(str, settings["validation"])),
        seed=int(settings["seed"]),
        drives="takeovers" if settings.get("drives") == "takeovers" else "all",
    )
    "".join(stored["logs"]).encode()  # raises ValueError for lone surrogates, which JSON may hold
    names: dict[str, list[str]] = {}
    for session, log in stored["logs"].items():
        names.setdefault(str(log["fingerprint"]), []).append(session)
    return config, names
