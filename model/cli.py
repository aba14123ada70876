"""`bc-train`: train a network on an index."""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from common import UserError
from common.command import DONE, warn, warn_skipped
from common.errors import UsageError, counted, first_of, printable
from common.files import session_name, short_path
from common.location import Location
from common.named_function import in_one_line, load_function
from common.output import print_message, print_result
from common.process_settings import use_large_pages
from common.ray_flag import RayAddress
from common.untrusted import real_path
from common.verbs import Verb, run_verbs
from model.config import TrainConfig
from model.export_cli import Export, export
from model.network.names import is_own
from model.runs.run_files import new_run_name
from model.train_flags import (
    EARLIER,
    INDEX,
    SESSIONS,
    VERBS,
    Continue,
    Places,
    ProgressFlags,
    Resume,
    Train,
    defaults_of_continued,
    defaults_of_new,
    defaults_of_resumed,
)

if TYPE_CHECKING:
    from common.recipe import Recipe
    from dataset import IndexConfig, Indexed
    from dataset.picture_spec import PictureSpec
    from model.device import Machine
    from model.network.choice import NetworkChoice
    from model.runs.training_progress import Listener
    from model.training.trainer import Trained


def train(config: Train) -> int:
    from model.runs.provenance import init_of
    from model.runs.run_folder import find_any_run

    if config.on and config.like is not None:
        raise UsageError("--on chooses the samples; with --like they are already chosen: leave out one of them")
    places, settings = config.places, config.config
    run = _new_run(config.name, places.runs)
    # first everything that can fail at once; building an index may take minutes
    like = find_any_run(config.like, places.runs) if config.like is not None else None
    init = init_of(like, places.runs) if like is not None else None
    network = _try_network(settings, init, like, config.ray)
    listeners = _listeners(config.progress, run, settings)
    with _trainer(config.ray, settings) as trainer:
        if config.on:
            index, code = _index_on(config.on, run, places, settings.recipe)
        elif like is not None:
            index, code = _index_of_run(like, places)
        else:
            index, code = _index_of_folder(places, settings.recipe)
        print_result(f"{run}: {network}")
        return max(code, _train(trainer, index, run, settings, listeners, init=init, like=like))


def resume(config: Resume) -> int:
    from dataset.samples.samples_format import SAMPLES_NAME
    from model.runs.run_folder import find_any_run

    places, settings = config.places, config.config
    run = find_any_run(config.run, places.runs)
    network = _try_resumed(settings, run, config.ray)
    listeners = _listeners(config.progress, run, settings)
    with _trainer(config.ray, settings) as trainer:
        index, code = places.index_of(run), DONE
        if not (index / SAMPLES_NAME).is_file():
            index, code = _index_of_run(run, places)
        print_result(f"{run}: {network}{_resumed_at(run, settings.epochs)}")
        return max(code, _train(trainer, index, run, settings, listeners, resume=True))


def continue_run(config: Continue) -> int:
    from model.runs.run_folder import find_run

    if config.on and config.takeovers:
        raise UsageError("--on, --takeovers: give one of them")
    places, settings = config.places, config.config
    run, init = _new_run(config.name, places.runs), find_run(config.run, places.runs)
    network = _try_network(settings, init, None, config.ray)
    listeners = _listeners(config.progress, run, settings)
    with _trainer(config.ray, settings) as trainer:
        if config.takeovers:
            index, code = _index_with_takeovers(config, run, init)
        elif config.on:
            index, code = _index_on(config.on, run, places, settings.recipe)
        else:
            index, code = _index_of_folder(places, settings.recipe)
        print_result(f"{run}: {network}")
        return max(code, _train(trainer, index, run, settings, listeners, init=init))


def _trainer(ray: RayAddress, settings: TrainConfig) -> AbstractContextManager[Callable[..., Trained]]:
    """A context manager that yields `train`, or with --ray a function that trains on a cluster. It connects before
    the index is built."""
    if ray is None:
        from model.training.trainer import train

        return nullcontext(train)
    from model.training.cluster_training import cluster_trainer

    return cluster_trainer(ray, settings)


def _train(
    trainer: Callable[..., Trained],
    index: Path,
    run: Path,
    settings: TrainConfig,
    listeners: Sequence[Listener],
    *,
    init: Path | None = None,
    like: Path | None = None,
    resume: bool = False,
) -> int:
    """Train and print the outcome. Returns the exit code."""
    from model.errors import RunWriteError

    try:
        trained = trainer(index, run, settings, listeners, init=init, like=like, resume=resume)
    except (KeyboardInterrupt, RunWriteError):
        if run.exists():
            print_message(f"bc-train: the run is kept; continue with `{_resume(run, index)}`")
        raise
    return max([DONE, *map(warn_skipped, trained.skipped), _print_outcome(trained, settings)])


def _try_network(settings: TrainConfig, init: Path | None, like: Path | None, ray: RayAddress) -> str:
    """Try the network on the device of the training; with --ray, on this machine's processor. Returns the text of
    the first printed line.

    Raises RunError if the network or the device does not exist, or if the weights of `init` are of another
    network. `like` is a run whose arithmetic is repeated.
    """
    from model.device import choose_machine
    from model.network.choice import choose_network, chosen_picture
    from model.runs.run_folder import load_config
    from model.training.trainer import refuse_other_network

    begun = load_config(like).get("machine") if like is not None else None
    machine = choose_machine(_tried_settings(settings, ray), begun)
    network = choose_network(settings)
    picture = chosen_picture(settings, network)
    if init is not None:
        refuse_other_network(init, network, picture, settings.targets)
    return _tried(network, picture, machine, settings.epochs, ray)


def _try_resumed(settings: TrainConfig, run: Path, ray: RayAddress) -> str:
    """`_try_network` for the network of a run that is resumed."""
    from model.device import choose_machine
    from model.network.own_code import load_code
    from model.runs.network_of_run import choice_of
    from model.runs.run_folder import load_config, picture_of_run

    stored = load_config(run)
    machine = choose_machine(_tried_settings(settings, ray), stored.get("machine"))
    if is_own(settings.network):
        load_code(settings.network)
    return _tried(choice_of(stored, run), picture_of_run(run), machine, settings.epochs, ray)


def _tried_settings(settings: TrainConfig, ray: RayAddress) -> TrainConfig:
    return settings if ray is None else replace(settings, device="cpu")


def _tried(network: NetworkChoice, picture: PictureSpec, machine: Machine, epochs: int, ray: RayAddress) -> str:
    parameters = network.try_out(picture, machine.device)
    where = f"{machine.arithmetic} on the {'GPU' if machine.device.type == 'cuda' else 'processor'}"
    if ray is not None:
        where = "on the cluster"
    name = "" if network.name == "original" else f"{printable(network.name)}, "
    passes = f"{counted(epochs, 'epoch')}, " if epochs else ""
    return f"{name}{parameters:,} parameters, {passes}{where}"


def _print_outcome(trained: Trained, settings: TrainConfig) -> int:
    """Print the outcome of a training and the command that drives with its run. Returns the exit code."""
    from model.runs.history import read_epochs
    from model.runs.run_folder import WEIGHTS, load_config
    from model.runs.run_numbers import run_numbers
    from model.runs.run_summary import judge
    from model.runs.training_progress import outcome_lines

    run, code = trained.run, max([DONE, *map(warn, trained.notices)])
    for remark in trained.remarks:
        print_message(remark)
    if trained.is_stopped_early:
        print_result(
            f"{run}: stopped early: {counted(settings.patience, 'epoch')} no better than the best (--patience)"
        )
    elif not trained.epochs:
        print_result(f"{run}: all its epochs are learnt; give more --epochs to continue")
    best = trained.best_epoch
    for line in outcome_lines(read_epochs(run), best, settings.keep) if best else ():
        print_result(line)
    drive = run_numbers(run, load_config(run), ()).drive_command
    print_result(f"{run / WEIGHTS}: the weights of epoch {best}; drive with `{drive}`")
    if best:
        print_result(*judge(run).lines)
    return code


def _resumed_at(run: Path, epochs: int) -> str:
    """The end of the first printed line: the position at which a resumed run continues; empty if it has learnt all
    its epochs."""
    from model.runs.checkpoint import read_position
    from model.runs.run_folder import has_nothing_saved

    if has_nothing_saved(run):
        return ", restarted from its seed: it was stopped before anything was saved"
    position = read_position(run)
    is_over = position.epoch > epochs
    return "" if is_over else f", continued in epoch {position.epoch:,} after batch {position.batch:,}"


def _resume(run: Path, index: Path) -> str:
    from model.runs.network_of_run import own_network_flag
    from model.runs.provenance import index_of
    from model.runs.run_files import run_argument
    from model.runs.run_folder import load_config

    stored = index_of(run)
    is_stored = isinstance(stored, Path) and real_path(stored) == real_path(index)
    given = "" if is_stored else f" --index {shlex.quote(str(index))}"
    return f"bc-train resume {run_argument(run)}{own_network_flag(load_config(run), run)}{given}"


def _listeners(progress: ProgressFlags, run: Path, settings: TrainConfig) -> list[Listener]:
    """The listeners of a training. Raises UserError if a package that one of them needs is not installed."""
    from model.runs.training_progress import EpochPrinter

    listeners: list[Listener] = [EpochPrinter(settings.keep)]
    if progress.tensorboard:
        from model.training.tensorboard import TensorBoard

        listeners.append(TensorBoard(run))
    if progress.listener is not None:
        listeners.append(_own_listener(progress.listener, run, settings))
    return listeners


def _own_listener(name: str, run: Path, config: TrainConfig) -> Listener:
    """Make the listener of --listener. Raises UserError if it is missing, cannot be made, or is not a listener."""
    make = load_function("--listener", name)
    try:
        listener: Listener = make(run, config)
    except Exception as error:
        raise UserError(f"--listener {printable(name)} fails ({in_one_line(error)})") from None
    missing = [name for name in ("step", "epoch", "close") if not callable(getattr(listener, name, None))]
    if missing:
        raise UserError(
            f"--listener {printable(name)}: expected a listener with step, epoch and close; it has no"
            f" {' and no '.join(missing)}"
        )
    return listener


def _new_run(name: str, runs: Path) -> Path:
    """The folder of a new run. Raises UsageError if its name is a path, or for one of several processes; RunError
    if it exists."""
    from model.runs.run_folder import refuse_existing_run

    if os.environ.get("WORLD_SIZE", "1") != "1":
        raise UsageError("one training is one process: start it without torchrun (WORLD_SIZE)")
    if Path(name).name != name or name.startswith((".", "-")):
        raise UsageError(f"--name {name!r}: expected a plain name; give the folder with --runs")
    if name in VERBS:
        raise UsageError(f"--name {name}: a verb of a command, which would not find the run; give another name")
    run = runs / (name or new_run_name())
    refuse_existing_run(run)
    return run


def _index_on(sessions: Sequence[str], run: Path, places: Places, recipe: Recipe) -> tuple[Path, int]:
    """Build the index of chosen sessions. Returns it and the exit code of its notices."""
    from dataset import IndexConfig, find_logs

    index = _own_index(run, places)
    logs = find_logs(sessions, places.sessions or SESSIONS)
    _, code = _build_own_index(logs, index, IndexConfig.of(recipe), places)
    return index, code


def _index_with_takeovers(config: Continue, run: Path, init: Path) -> tuple[Path, int]:
    """Build the index of the logs of `init` and of takeovers. Returns it and the exit code of its notices."""
    from model.runs.provenance import logs_with_takeovers

    places = config.places
    index = _own_index(run, places)
    before, takeovers, settings = logs_with_takeovers(
        init, config.takeovers, places.sessions or SESSIONS, config.drives, print_message
    )
    indexed, code = _build_own_index([*before, *takeovers], index, settings, places)
    added = [indexed.counts[name] for name in map(session_name, takeovers) if name in indexed.counts]
    if not any(count.training for count in added):
        shutil.rmtree(index)
        raise UserError(f"{first_of([str(log) for log in takeovers])}: no frame of a takeover to learn from")
    return index, code


def _own_index(run: Path, places: Places) -> Path:
    """The folder of the index that is built for one run. Raises UserError if it exists."""
    index = (places.index or INDEX).with_name(f"index-{run.name}")
    if index.exists() or index.is_symlink():
        raise UserError(f"{index} exists already, perhaps of a stopped training: remove it, or give a new --name")
    return index


def _build_own_index(
    logs: Sequence[Location], index: Path, settings: IndexConfig, places: Places
) -> tuple[Indexed, int]:
    print_message(f"{index}: built of {counted(len(logs), 'session')}")
    return _build_index(logs, index, settings, places.sessions or SESSIONS, [session_name(log) for log in logs])


def _index_of_run(run: Path, places: Places) -> tuple[Path, int]:
    """The index of the samples that a run was trained on, built if missing, and the exit code of its notices."""
    from dataset.samples.samples_format import SAMPLES_NAME
    from model.runs.provenance import index_of_run, sessions_of

    given = places.index_of(run)
    sessions = places.sessions or sessions_of(run) or SESSIONS
    codes = [DONE]
    index = index_of_run(run, given, sessions, lambda notice: codes.append(warn(notice)))
    if (given / SAMPLES_NAME).is_file() and index != real_path(given):
        print_message(f"{given}: not the samples of {run}, which are in {short_path(index)}")
    return index, max(codes)


def _index_of_folder(places: Places, recipe: Recipe) -> tuple[Path, int]:
    """The index of all sessions, built if missing, and the exit code of its notices."""
    from dataset import IndexConfig, find_logs, sessions_not_indexed
    from dataset.missing_index import missing_index
    from dataset.samples.samples_format import SAMPLES_NAME, not_learnt_in

    index, sessions = places.index or INDEX, places.sessions or SESSIONS
    if not (index / SAMPLES_NAME).is_file():
        # only of the default name, in a folder that exists: another name may be misspelt
        if not (index.name == INDEX.name and index.parent.is_dir()):
            raise missing_index(index)
        print_message(f"{index}: no index yet; building it from {sessions}")
        _, code = _build_index(find_logs((), sessions), index, IndexConfig.of(recipe), sessions)
        return index, code
    for line in not_learnt_in(index):
        print_message(line)
    if absent := sessions_not_indexed(index, sessions):
        print_message(f"{index}: does not hold {first_of(absent)}; `bc-index` takes in all of {sessions}")
    return index, DONE


def _build_index(
    logs: Sequence[Location], index: Path, settings: IndexConfig, folder: Path, sessions: Sequence[str] = ()
) -> tuple[Indexed, int]:
    """Build an index as `bc-index` does: skip and print logs that cannot be read. Also returns the exit code."""
    from dataset import build_index
    from dataset.index.index_report import print_log_notices

    indexed = build_index(logs, index, settings, leave_out_unreadable=True)
    return indexed, print_log_notices(indexed, folder, sessions)


def main() -> None:
    use_large_pages()
    verbs = {
        "resume": Verb(Resume, resume, defaults_of_resumed),
        "continue": Verb(Continue, continue_run, defaults_of_continued),
        "export": Verb(Export, export),
    }
    run_verbs("bc-train", Verb(Train, train, defaults_of_new), verbs, EARLIER)
