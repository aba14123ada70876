"""`bc-train`: train a network on an index."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from common import UserError
from common.command import DONE, run_command, warn, warn_skipped
from common.errors import counted, first_of, printable
from common.files import short_path
from common.location import Location
from common.named_function import in_one_line, load_function
from common.output import print_message, print_result
from common.process_settings import use_large_pages
from common.untrusted import real_path
from model.config import TrainConfig
from model.epoch_printer import EpochPrinter
from model.network.names import is_own
from model.runs.run_arguments import new_run_name
from model.train_flags import Train, defaults, refuse_contradictions

if TYPE_CHECKING:
    from dataset import IndexConfig, Indexed
    from model.runs.training_progress import Listener
    from model.training.trainer import Trained


def train(config: Train) -> int:
    refuse_contradictions(config)
    from model.errors import RunWriteError
    from model.runs.run_folder import find_any_run, find_run
    from model.training.trainer import train as train_network

    is_resumed, settings = config.resume is not None, config.config
    # first everything that can fail at once; building an index may take minutes
    run = _run_of(config)
    init = find_run(config.init, config.runs) if config.init is not None else None
    if init is not None and config.takeovers:
        from model.runs.network_of_run import network_settings
        from model.runs.run_folder import load_config

        settings = replace(settings, **network_settings(load_config(init), init))
        config = replace(config, config=settings)
    like = run if is_resumed else None
    if config.like is not None:
        like = find_any_run(config.like, config.runs)
    summary = _try_network(config, run, init, like)
    listeners = _listeners(config, run)
    is_own_index = bool(config.on or config.takeovers)
    index, code = _own_index(config, run, init) if is_own_index else _index_of(config, like)
    print_result(f"{run}: {summary}{_resumed_at(run, settings.epochs) if is_resumed else ''}")
    try:
        trained = train_network(index, run, settings, listeners, init=init, like=like, resume=is_resumed)
    except (KeyboardInterrupt, RunWriteError):
        if run.exists():
            print_message(f"bc-train: the run is kept; continue with `{_resume(run, index)}`")
        raise
    return max([code, *map(warn_skipped, trained.skipped), _print_outcome(trained, settings)])


def _try_network(config: Train, run: Path, init: Path | None, like: Path | None) -> str:
    """Try the network on the device of the training. Returns the text of the first printed line.

    Raises RunError if the network or the device does not exist, or if the first weights are of another network.
    """
    from model.device import choose_machine
    from model.network.choice import choose_network, chosen_picture
    from model.network.own_code import load_code
    from model.runs.network_of_run import choice_of
    from model.runs.run_folder import load_config, picture_of_run
    from model.training.earlier_run import refuse_other_network

    settings = config.config
    begun = load_config(like).get("machine") if like is not None else None
    machine = choose_machine(settings, begun)
    if config.resume is None:
        network = choose_network(settings)
        picture = chosen_picture(settings, network)
        if init is not None:
            refuse_other_network(init, network, picture, settings.targets)
    else:
        if is_own(settings.network):
            load_code(settings.network)
        network, picture = choice_of(load_config(run), run), picture_of_run(run)
    parameters = network.try_out(picture, machine.device)
    where = f"{machine.arithmetic} on the {'GPU' if machine.device.type == 'cuda' else 'processor'}"
    name = "" if network.name == "original" else f"{printable(network.name)}, "
    passes = f"{counted(settings.epochs, 'epoch')}, " if settings.epochs else ""
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
    from model.runs.run_arguments import run_argument
    from model.runs.run_folder import load_config
    from model.runs.run_inputs import index_of

    stored = index_of(run)
    is_stored = isinstance(stored, Path) and real_path(stored) == real_path(index)
    given = "" if is_stored else f" --index {shlex.quote(str(index))}"
    return f"bc-train --resume {run_argument(run)}{own_network_flag(load_config(run), run)}{given}"


def _listeners(config: Train, run: Path) -> list[Listener]:
    """The listeners of a training. Raises UserError if a package that one of them needs is not installed."""
    listeners: list[Listener] = [EpochPrinter(config.config.keep)]
    if config.tensorboard:
        from model.training.tensorboard import TensorBoard

        listeners.append(TensorBoard(run))
    if config.listener is not None:
        listeners.append(_own_listener(config.listener, run, config.config))
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


def _run_of(config: Train) -> Path:
    from model.runs.run_folder import find_any_run, refuse_existing_run

    if config.resume is not None:
        return find_any_run(config.resume, config.runs)
    run = config.runs / (config.name or new_run_name())
    refuse_existing_run(run)
    return run


def _own_index(config: Train, run: Path, init: Path | None) -> tuple[Path, int]:
    """Build the index of --on or --takeovers. Returns it and the exit code of its notices."""
    from common.files import session_name
    from dataset import IndexConfig, find_logs
    from model.runs.reproduce import logs_with_takeovers

    index = config.index.with_name(f"index-{run.name}")
    if index.exists() or index.is_symlink():
        raise UserError(f"{index} exists already, perhaps of a stopped training: remove it, or give a new --name")
    takeovers: list[Location] = []
    if init is not None and config.takeovers:
        before, takeovers, settings = logs_with_takeovers(
            init, config.takeovers, config.sessions, config.drives, print_message
        )
        logs = [*before, *takeovers]
    else:
        logs, settings = find_logs(config.on, config.sessions), IndexConfig.of(config.config.recipe)
    print_message(f"{index}: built of {counted(len(logs), 'session')}")
    names = [session_name(log) for log in logs]
    indexed, code = _build_index(logs, index, settings, config.sessions, names)
    added = [indexed.counts[name] for name in map(session_name, takeovers) if name in indexed.counts]
    if takeovers and not any(count.training for count in added):
        shutil.rmtree(index)
        raise UserError(f"{first_of([str(log) for log in takeovers])}: no frame of a takeover to learn from")
    return index, code


def _index_of(config: Train, like: Path | None) -> tuple[Path, int]:
    """The index to train on, built if missing, and the exit code of its notices. `like` is the run to resume or
    repeat."""
    from dataset import IndexConfig, find_logs, sessions_not_indexed
    from dataset.missing_index import missing_index
    from dataset.samples.samples_format import SAMPLES_NAME, not_learnt_in

    is_built = (config.index / SAMPLES_NAME).is_file()
    if like is not None and (config.resume is None or not is_built):
        from model.runs.reproduce import index_of_run

        codes = [DONE]
        index = index_of_run(like, config.index, config.sessions, lambda notice: codes.append(warn(notice)))
        if is_built and index != real_path(config.index):
            print_message(f"{config.index}: not the samples of {like}, which are in {short_path(index)}")
        return index, max(codes)
    if not is_built:
        index = config.index
        # only of the default name, in a folder that exists: another name may be misspelt
        if not (index.name == Train.index.name and index.parent.is_dir()):
            raise missing_index(index)
        print_message(f"{config.index}: no index yet; building it from {config.sessions}")
        logs, settings = find_logs((), config.sessions), IndexConfig.of(config.config.recipe)
        _, code = _build_index(logs, config.index, settings, config.sessions)
        return config.index, code
    if config.resume is None:
        for line in not_learnt_in(config.index):
            print_message(line)
        if absent := sessions_not_indexed(config.index, config.sessions):
            print_message(
                f"{config.index}: does not hold {first_of(absent)}; `bc-index` takes in all of {config.sessions}"
            )
    return config.index, DONE


def _build_index(
    logs: Sequence[Location], index: Path, settings: IndexConfig, folder: Path, sessions: Sequence[str] = ()
) -> tuple[Indexed, int]:
    """Build an index as `bc-index` does: skip and print logs that cannot be read. Also returns the exit code."""
    from dataset import build_index
    from dataset.index.index_report import print_log_notices

    indexed = build_index(logs, index, settings, leave_out_unreadable=True)
    return indexed, print_log_notices(indexed, folder, sessions)


def main() -> None:
    if sys.argv[1:2] == ["export"]:
        from model.export_cli import main as export

        export()
    use_large_pages()
    run_command("bc-train", Train, train, default=defaults)
