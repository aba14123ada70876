"""The run folder: weights, their provenance and the history of the training. Nothing in it is ever unpickled.

runs/NAME/model.safetensors   the weights of the kept epoch, which drive; with their checksum, see checksums.py
runs/NAME/config.json         everything needed to reproduce the run and to drive with it
runs/NAME/network.py          the code of the network, if it is a user's own file
runs/NAME/metrics.jsonl       one line an epoch
runs/NAME/steps.jsonl         one line every few batches
runs/NAME/worst.jsonl         one line an epoch: the frames held out with the largest errors
runs/NAME/last/               the state of the training: see checkpoint.py
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy  # noqa: F401  # before PyTorch, whose own import of NumPy drops a Ctrl-C
from safetensors import SafetensorError, safe_open
from torch import Tensor

from common.errors import UsageError, printable
from common.files import remove_empty
from common.location import local_path
from common.untrusted import real_path
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.prediction_targets import TargetName, speed_ahead_s_in
from model.errors import RunError
from model.network.names import BUILT_IN, check_network_name, is_own
from model.network.own_code import load_code
from model.network.picture_network import PictureNetwork
from model.runs.answer_scale import AnswerScale
from model.runs.checkpoint import checkpoint_path, load_checksummed, position_of, save_checksummed
from model.runs.network_of_run import NETWORK_FILE, choice_of, is_own_network, picture_of, stored_targets
from model.runs.run_files import CONFIG as CONFIG
from model.runs.run_files import (
    FORMAT,
    LAST,
    is_being_trained,
    is_last_weights,
    replaced_file,
    run_argument,
    run_write_errors,
    suggest_runs,
    weights_path,
)
from model.runs.run_files import WEIGHTS as WEIGHTS
from model.runs.run_files import config_folder as config_folder
from model.runs.run_files import load_config as load_config
from model.runs.run_files import weights_checksum as weights_checksum

_REMEDY: Final = "copy it again, or train the run again"


def create_run(
    folder: Path, config: dict[str, Any], picture: PictureSpec = ORIGINAL, network_file: bytes = b""
) -> None:
    """Make a run folder with its config and, if the network is a user's own file, that file. Raises RunError if
    `folder` exists."""
    refuse_existing_run(folder)
    with run_write_errors(folder):
        folder.mkdir(parents=True)
    try:
        if network_file:
            with replaced_file(folder / NETWORK_FILE) as part:
                part.write_bytes(network_file)
        write_config(folder, {"format": FORMAT, "preprocessing": picture.description, **config})
    except BaseException:
        (folder / NETWORK_FILE).unlink(missing_ok=True)
        remove_empty([folder])
        raise


def refuse_existing_run(folder: Path) -> None:
    """Raise RunError if the name of a new run is taken."""
    if (folder / CONFIG).is_file():
        raise RunError(
            f"{folder}: exists already; give another --name, or continue it:"
            f" `bc-train resume {run_argument(folder)}`"
        )
    if os.path.lexists(folder):
        raise RunError(f"{folder}: exists already, and is not a run; give another --name, or remove it")


def write_config(folder: Path, config: dict[str, Any]) -> None:
    with replaced_file(folder / CONFIG) as part:
        part.write_text(json.dumps(config, indent=2) + "\n", encoding="utf-8")


def run_name(folder: Path) -> str:
    """NAME for runs/NAME; NAME-last for runs/NAME/last, the weights after the last epoch."""
    folder = real_path(folder)
    return f"{folder.parent.name}-{LAST}" if is_last_weights(folder) else folder.name


def save_weights(
    folder: Path, weights: Mapping[str, Tensor], epoch: int, answers: AnswerScale | None = None
) -> None:
    """Replace the run's weights in one step: a full disk or a crash leaves the old ones.

    The weights are as learnt; `answers` is the scale for their answers.
    """
    scale = {} if answers in (None, AnswerScale()) else answers.metadata
    save_checksummed(folder / WEIGHTS, weights, {"epoch": str(epoch), **scale})


@contextlib.contextmanager
def removed_unless_saved(folder: Path, has_learnt: Callable[[], bool]) -> Iterator[None]:
    """Remove the new run in `folder` if its training in this block ends before it saves anything, so that the name
    is free again."""
    try:
        yield
    finally:
        if not has_learnt():
            shutil.rmtree(folder)


def find_run(name: str | None, runs: Path | str) -> Path:
    """Find a trained run by name (in `runs`) or by path. Without a name: the run with the newest weights.
    NAME/last has a run's last weights. Raises RunError; UserError for a URL."""
    runs = local_path(runs)
    if name is not None:
        local_path(name)
    if name is None:
        weights = sorted(runs.glob(f"*/{WEIGHTS}"), key=lambda path: path.stat().st_mtime_ns)
        if not weights:
            raise RunError(f"{runs}: no trained run in it; train one with `bc-train`")
        return weights[-1].parent
    for folder in (runs / name, Path(name)):
        if (folder / WEIGHTS).is_file() or is_last_weights(folder):
            return folder
    if (runs / name / CONFIG).is_file():
        if is_being_trained(runs / name):
            raise RunError(
                f"{runs / name}: is being trained, and its first epoch is not finished: wait for it; `bc-runs`"
                " shows how far it is"
            )
        resume = f"`bc-train resume {run_argument(runs / name)}`"
        raise RunError(f"{runs / name}: its first epoch is not finished; {resume}")
    raise _missing(name, runs, "trained run", WEIGHTS)


def has_nothing_saved(run: Path) -> bool:
    """True if a run was killed before its first checkpoint: nothing of its training was saved."""
    return not checkpoint_path(run).exists() and not (run / WEIGHTS).exists()


def find_any_run(name: str, runs: Path) -> Path:
    """Find a run by name (in `runs`) or by path, even if it has not finished an epoch. Raises RunError if it does
    not exist; UserError for a URL."""
    local_path(name)
    for folder in (runs / name, Path(name)):
        if (folder / CONFIG).is_file():
            return folder
    raise _missing(name, runs, "run", CONFIG)


def _missing(name: str, runs: Path, kind: str, file: str) -> RunError:
    """The error if no run is called `name`, with a suggestion."""
    given = Path(name)
    place = given if len(given.parts) > 1 else runs / name
    name = given.name if given.parent == runs else name  # runs/frist is in this folder, hub/frist is not
    names = sorted(path.parent.name for path in runs.glob(f"*/{file}"))
    return RunError(f"{place}: no {kind} there ({file} is missing); {suggest_runs(name, names, runs)}")


def picture_of_run(folder: Path) -> PictureSpec:
    """The picture that the run's network sees. Raises RunError as `load_config` does."""
    return picture_of(load_config(folder), folder)


def targets_of_run(folder: Path) -> tuple[TargetName, ...]:
    """The targets that the run's network answers, steering first. Raises RunError as `load_config` does."""
    return stored_targets(load_config(folder), folder)


def speed_ahead_s_of_run(folder: Path) -> float:
    """The time in seconds after which the car should have the speed that the run's network answers; 0 if the
    config does not record it. Raises RunError as `load_config` does."""
    data = load_config(folder).get("data")
    return speed_ahead_s_in(data.get("settings")) if isinstance(data, dict) else 0.0


def load_named(names: Sequence[str | None], runs: Sequence[Path]) -> None:
    """Run the code of the networks that a user has named for `runs`; skip None.

    Raises UsageError for a name that no run needs, RunError if the code does not exist.
    """
    for name in names:
        if name is None:
            continue
        try:
            check_network_name(name)
        except ValueError as error:
            raise UsageError(str(error)) from None
        if not is_own(name) or not any(is_own_network(load_config(run)) for run in runs):
            raise UsageError(
                f"--network {printable(name)}: no run here needs your own code: runs know"
                f" {', '.join(BUILT_IN)} by themselves; leave it out"
            )
        load_code(name)


def load_network(folder: Path) -> PictureNetwork:
    """The run's network, ready to predict. Raises RunError if the weights are damaged or of another shape, or if
    the network is a user's own and was not named, or does not work on this machine."""
    choice = choice_of(load_config(folder), config_folder(folder))
    network = choice.build()
    answers = load_weights(folder, network)
    if choice.code is not None:
        choice.try_network(network, picture_of_run(folder))
    network.natural = answers.natural if answers != AnswerScale() else None
    return network.eval()


def load_weights(folder: Path, network: PictureNetwork) -> AnswerScale:
    """Load the run's weights, as learnt, into `network`. Returns the scale of the run's answers. Raises RunError
    if the weights are damaged, or do not fit."""
    path = weights_path(folder)
    weights, stored = load_checksummed(path, config_folder(folder), network, _REMEDY)
    if is_last_weights(folder):
        prefix = "averaged." if any(name.startswith("averaged.") for name in weights) else "network."
        weights = {name.removeprefix(prefix): weights[name] for name in weights if name.startswith(prefix)}
    try:
        network.load_state_dict(weights)
    except RuntimeError:
        raise RunError(f"{path}: weights of another network than its config.json names; train it again") from None
    return _answer_scale(stored, path)


def load_answer_scale(folder: Path) -> AnswerScale:
    """The scale of the answers of the run's network. Raises RunError if its weights cannot be read."""
    path = weights_path(folder)
    try:
        with safe_open(path, framework="pt") as file:
            return _answer_scale(file.metadata() or {}, path)
    except (OSError, SafetensorError) as error:
        raise RunError(f"{path}: cannot be read ({error}); {_REMEDY}") from None


def _answer_scale(stored: Mapping[str, str], path: Path) -> AnswerScale:
    if "position" in stored:
        position = position_of(stored, path)
        return AnswerScale(position.answer_scale, position.answer_offset, position.answer_curve)
    try:
        return AnswerScale.from_metadata(stored)
    except ValueError as error:
        raise RunError(f"{path}: damaged: {error}; {_REMEDY}") from None
