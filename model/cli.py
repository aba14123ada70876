"""`bc-train`: a network learns to steer from the index."""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import sys
from dataclasses import dataclass, field, replace
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from common import UserError
from common.command import DONE, FAILED, run_command, warn, warn_skipped
from common.errors import UsageError, counted, printable
from common.location import Location, Url, absolute, is_in_store, local_path, location
from common.location_flag import LocationFlag
from common.named_function import in_one_line, load_function
from common.output import print_message, print_result
from common.random_access import is_there
from common.recipe import recipe_given
from common.streams import end_process
from model.config import TrainConfig
from model.epoch_printer import EpochPrinter
from model.network.names import is_own
from model.runs.run_arguments import RUNS

if TYPE_CHECKING:
    from model.runs.training_progress import Listener


_MOST_WORKERS: Final = 10_000


@dataclass(frozen=True)
class Train:
    """Train the network on the index; the run is kept in runs/NAME/.

    The index is built from all sessions if there is none yet, and --index names no other folder. Ctrl-C stops
    after the current batch, and --resume goes on from there. `bc-train export RUN --onnx` gives a trained network
    to other programs, --hub FOLDER to the Hugging Face hub.
    """

    name: str = ""
    """Name of the run; by default the date and time."""
    resume: str | None = None
    """Go on with this run where it was stopped or killed; more --epochs make it longer. One in a store (s3://...)
    is brought to runs/, and copied there as it goes on."""
    init: str | None = None
    """Start from the weights of this run, instead of random ones."""
    like: str | None = None
    """Repeat this run: its settings, and the index that it was trained on. Other flags change what they name."""
    tensorboard: bool = False
    """Write the curves for TensorBoard, too."""
    listener: str | None = None
    """Code of your own that receives the progress, for MLflow and the like: FILE.py:CLASS or
    package.module:CLASS."""
    viewer: bool = False
    """Show the curves in the Rerun viewer while they grow."""
    ray: Annotated[
        tuple[str, ...] | None, tyro.conf.arg(metavar="N [ADDRESS]", help_behavior_hint="(default: none)")
    ] = None
    """Train on N workers of a Ray cluster, which go on from the checkpoint where one dies; all of its nodes see
    these folders by the same paths."""
    index: LocationFlag = Path("index")
    """The index to train on: a folder, or the URL of a copy of one in a store."""
    sessions: LocationFlag = Path("sessions")
    """Where logs are kept, for an index that has to be built."""
    runs: LocationFlag = RUNS
    """Where runs are kept. With a URL (s3://BUCKET/runs) the run is made in runs/, and copied there while it is
    trained, and when that ends."""
    copy_to: Annotated[LocationFlag | None, tyro.conf.arg(metavar="URL")] = None
    """Copy the run to this folder in a store as well, if runs are kept here."""
    config: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


def train(config: Train) -> int:
    _refuse_contradictions(config)
    if isinstance(config.runs, Url):
        config = _copied_to(config.runs, config)

    from model.device import choose_machine
    from model.errors import RunWriteError
    from model.network.choice import choose_network, chosen_picture
    from model.network.own_code import load_code
    from model.runs.history import read_epochs
    from model.runs.network_of_run import choice_of
    from model.runs.run_arguments import run_argument
    from model.runs.run_folder import WEIGHTS, find_any_run, find_run, load_config, picture_of_run
    from model.runs.stored_run import RunCopy, place_of_copies
    from model.runs.training_outcome import verdict
    from model.training.distributed import FirstRankError, local_rank_of_process, rank_of_process
    from model.training.other_network import refuse_other_network
    from model.training.trainer import train as train_network

    workers = _workers(config.ray)
    is_first = rank_of_process() == 0
    settings = config.config
    # all that can fail at once, before the minutes that an index may take
    run = _run_of(config)
    copies = config.copy_to
    if copies is None and config.resume is not None and is_in_store(config.resume):
        copies = location(config.resume.rstrip("/").rpartition("/")[0])
    copied_to = None if copies is None else place_of_copies(copies, run, is_new=config.resume is None)
    init = find_run(config.init, config.runs) if config.init is not None else None
    like = run if config.resume is not None else None
    if config.like is not None:
        like = find_any_run(config.like, config.runs)
    begun = load_config(like).get("machine") if like is not None else None
    here = settings if config.ray is None else replace(settings, device="cpu")  # workers choose for themselves
    machine = choose_machine(here, local_rank_of_process(), begun)
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
    listeners = _listeners(config, run) if is_first else []
    copy = RunCopy(run, copied_to) if copied_to is not None and is_first else None
    if copy is not None:
        listeners.append(copy)
    index, code = _index_of(config, is_first=is_first)
    if is_first:
        where = f"{machine.arithmetic} on the {'GPU' if machine.device.type == 'cuda' else 'processor'}"
        if workers is not None:
            where = f"on {counted(workers[0], 'worker')} of a cluster"
        epochs = counted(settings.epochs, "epoch")
        print_result(
            f"{run}: {_named(network.name)}{parameters:,} parameters, {epochs},"
            f" {where}"
            f"{_going_on(run) if config.resume is not None else ''}"
        )
    try:
        with _viewer(config, run) if is_first else contextlib.nullcontext():
            is_resumed = config.resume is not None
            if workers is None:
                trained = train_network(index, run, settings, listeners, init=init, like=like, resume=is_resumed)
            else:
                from model.training.ray_workers import train_on_cluster

                trained = train_on_cluster(
                    *workers, index, run, settings, listeners, init=init, like=like, resume=is_resumed
                )
    except (KeyboardInterrupt, RunWriteError):
        if is_first and run.exists():
            to = f" --copy-to {copies}" if copies is not None else ""
            print_message(f"bc-train: what is learnt is kept; go on with `{_resume(run, index)}{to}`")
        raise
    except FirstRankError:
        return FAILED  # the first one prints why
    finally:
        if copy is not None and (problem := copy.finish()):
            code = warn(f"{problem}; `{_resume(run, index)} --copy-to {copies}` copies the rest")
    code = max([code, *map(warn_skipped, trained.skipped)])
    if not is_first:
        return code
    code = max([code, *map(warn, trained.notices)])
    for remark in trained.remarks:
        print_message(remark)
    if trained.is_stopped_early:
        print_result(
            f"{run}: stopped early: {counted(settings.patience, 'epoch')} no better than the best (--patience)"
        )
    elif not trained.epochs:
        print_result(f"{run}: all its epochs are learnt; give more --epochs to go on")
    best = trained.best_epoch
    for line in verdict(read_epochs(run), best, settings.keep) if best else ():
        print_result(line)
    drive = f"bc-drive {run_argument(run)}{_network_flag(run)}"
    print_result(f"{run / WEIGHTS}: the weights of epoch {best}; drive with `{drive}`")
    return code


def _copied_to(runs: Url, config: Train) -> Train:
    """The same training in a folder of this machine, copied to where runs are kept."""
    from model.runs.runs_in_store import url_of

    init, like, resume = (url_of(name, runs) for name in (config.init, config.like, config.resume))
    is_brought = resume is not None and is_in_store(resume)  # and goes back to where it came from
    copy_to = None if is_brought else runs
    return replace(config, runs=RUNS, copy_to=copy_to, init=init, like=like, resume=resume)


def _workers(ray: tuple[str, ...] | None) -> tuple[int, str] | None:
    """Number and address that --ray gives. Raises UsageError for what are none."""
    if ray is None:
        return None
    from common.ray_cluster import address_of

    number, *address = ray or ("",)
    if not number.isascii() or not number.isdigit() or not 0 < int(number) <= _MOST_WORKERS:
        raise UsageError(f"--ray {' '.join(ray)}: a number of workers was expected, and perhaps an address")
    if "WORLD_SIZE" in os.environ:
        raise UsageError("--ray and torchrun each start the workers: give one of them")
    return int(number), address_of(address)


def _named(network: str) -> str:
    """A network's name for the line that is printed first; the original's needs none."""
    return "" if network == "original" else f"{printable(network)}, "


def _going_on(run: Path) -> str:
    """The end of the line that is printed first: where a resumed run goes on."""
    from model.runs.checkpoint import read_position
    from model.runs.run_folder import has_nothing_saved

    if has_nothing_saved(run):
        return ", begun again from its seed: it was stopped before anything was saved"
    begin = read_position(run)
    return f", going on in epoch {begin.epoch:,} after batch {begin.batch:,}"


def _resume(run: Path, index: Location) -> str:
    """The command that goes on with a run."""
    from model.runs.run_arguments import run_argument
    from model.runs.run_inputs import index_of

    command = "bc-train" if "WORLD_SIZE" not in os.environ else "torchrun ... --no-python bc-train"
    stored = index_of(run)
    is_stored = stored is not None and absolute(stored) == absolute(index)
    given = "" if is_stored else f" --index {shlex.quote(str(index))}"
    return f"{command} --resume {run_argument(run)}{_network_flag(run)}{given}"


def _network_flag(run: Path) -> str:
    """The flag that a run of somebody's own network needs, because its code is never run unasked."""
    from model.runs.network_of_run import network_flag, stored_network
    from model.runs.run_folder import load_config

    stored = stored_network(load_config(run), run)
    return f" {network_flag(stored, run)}" if is_own(stored.name) else ""


def _listeners(config: Train, run: Path) -> list[Listener]:
    """Raises UserError where what one of them needs is not installed."""
    if config.viewer and find_spec("rerun") is None:
        raise UserError("--viewer: the viewer is not installed here: `pip install rerun-sdk` brings it")
    listeners: list[Listener] = [EpochPrinter()]
    if config.tensorboard:
        from model.training.tensorboard import TensorBoard

        listeners.append(TensorBoard(run))
    if config.listener is not None:
        listeners.append(_own_listener(config.listener, run, config.config))
    return listeners


def _own_listener(name: str, run: Path, config: TrainConfig) -> Listener:
    """Raises UserError where it is not there, cannot be made, or is none."""
    make = load_function("--listener", name)
    try:
        listener: Listener = make(run, config)
    except Exception as error:
        raise UserError(f"--listener {printable(name)} fails ({in_one_line(error)})") from None
    missing = [each for each in ("step", "epoch", "close") if not callable(getattr(listener, each, None))]
    if missing:
        raise UserError(
            f"--listener {printable(name)}: a listener was expected, with step, epoch and close; it has no"
            f" {' and no '.join(missing)}"
        )
    return listener


def _viewer(config: Train, run: Path) -> contextlib.AbstractContextManager[None]:
    if not config.viewer:
        return contextlib.nullcontext()
    from common.preview import preview

    return preview(run)


def _refuse_contradictions(config: Train) -> None:
    """Raise UsageError for flags that do not go together."""
    others = {"--name": config.name, "--init": config.init, "--like": config.like}
    if config.resume is not None and (unfit := [flag for flag, value in others.items() if value]):
        raise UsageError(f"{' and '.join(unfit)} make another run, --resume goes on with one: give one of them")
    if isinstance(config.runs, Url) and config.copy_to is not None:
        raise UsageError(f"--runs {config.runs}: is where the run is copied to: leave out --copy-to")
    if Path(config.name).name != config.name or config.name.startswith("."):
        raise UsageError(f"--name {config.name!r}: a plain name was expected; give the folder with --runs")


def _run_of(config: Train) -> Path:
    from model.runs.run_folder import find_any_run, refuse_existing_run

    if config.resume is not None:
        return find_any_run(_here(config.resume), config.runs)
    name = config.name or datetime.now().astimezone().strftime("%Y-%m-%d_%H-%M-%S")
    run = local_path(config.runs) / name
    refuse_existing_run(run)
    return run


def _here(resumed: str) -> str:
    """The name of a run that --resume has brought here."""
    return resumed.rstrip("/").rpartition("/")[2] if is_in_store(resumed) else resumed


def _index_of(config: Train, *, is_first: bool) -> tuple[Location, int]:
    """The index to train on, built if need be, and the exit code of what had to be printed about it."""
    from dataset import sessions_not_indexed
    from dataset.missing_index import missing_index
    from dataset.samples.samples_format import SAMPLES_NAME

    is_built = is_there(config.index / SAMPLES_NAME)
    if config.like is not None or (config.resume is not None and not is_built):
        from model.runs.reproduce import index_of_run
        from model.runs.run_folder import find_any_run

        name = config.like if config.like is not None else _here(config.resume or "")
        assert name is not None  # noqa: S101
        codes = [DONE]

        def on_notice(notice: str) -> None:
            if is_first:
                codes.append(warn(notice))

        return index_of_run(find_any_run(name, config.runs), config.index, config.sessions, on_notice), max(codes)
    if not is_built:
        if not _is_built_unasked(config.index):
            raise missing_index(config.index)
        if "WORLD_SIZE" in os.environ:
            raise UserError(f"{config.index}: no index yet; build it with `bc-index` before torchrun")
        print_message(f"{config.index}: no index yet; building it from {config.sessions}")
        return config.index, _build_index(config)
    is_current_index = is_first and config.resume is None and isinstance(config.index, Path)
    if is_current_index and (absent := sessions_not_indexed(local_path(config.index), config.sessions)):
        print_message(
            f"{config.index}: does not hold {', '.join(absent)}; `bc-index` takes in all of {config.sessions}"
        )
    return config.index, DONE


def _is_built_unasked(index: Location) -> bool:
    """True for a folder of the default's name in one that is there: another name may be misspelt."""
    return isinstance(index, Path) and index.name == Train.index.name and index.parent.is_dir()


def _build_index(config: Train) -> int:
    """Build the index as `bc-index` does: leave out and print what cannot be read. Returns the exit code."""
    from dataset import IndexConfig, build_index, find_logs
    from dataset.index.index_report import print_log_notices

    settings = IndexConfig.of(config.config.recipe)
    logs, index = find_logs((), config.sessions), local_path(config.index)
    indexed = build_index(logs, index, settings, leave_out_unreadable=True)
    return print_log_notices(indexed, config.sessions)


def _defaults() -> Train:
    """The defaults of the flags: the settings and places of the run that is named with --resume or --like.

    Raises UsageError for the recipe of another run than the one to be repeated: no setting would follow from it.
    """
    given = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    given.add_argument("--resume")
    given.add_argument("--like")
    given.add_argument("--runs", type=location, default=RUNS)
    given.add_argument("--network")
    with contextlib.suppress(argparse.ArgumentError):  # tyro prints what is wrong
        flags, _ = given.parse_known_args()
        name, runs = flags.resume if flags.resume is not None else flags.like, flags.runs
        if name:
            from model.runs.network_of_run import choice_of, is_own_network
            from model.runs.provenance import training_of
            from model.runs.run_folder import CONFIG, find_any_run, load_config
            from model.runs.run_inputs import index_of, init_of, sessions_of
            from model.runs.runs_in_store import url_of

            if isinstance(runs, Url):
                name = url_of(name, runs)
            if flags.resume is not None and is_in_store(name):
                from model.runs.stored_run import bring_run_to

                run = bring_run_to(RUNS if isinstance(runs, Url) else runs, name)
            else:
                run = find_any_run(name, runs)
            stored = load_config(run)
            if is_own_network(stored) and flags.network is None:
                choice_of(stored, run)  # raises: code is never run because a run names it
            settings = training_of(stored, str(run / CONFIG))
            if flags.resume is None and recipe_given(settings.recipe) != settings.recipe:
                raise UsageError("--recipe with --like: that run's settings are repeated; leave out one of them")
            init = init_of(run, runs) if flags.resume is None else None
            return Train(
                init=str(init) if init is not None else None,
                index=index_of(run) or Train.index,
                sessions=sessions_of(run) or Train.sessions,
                config=settings,
            )
    return Train(config=TrainConfig.of(recipe_given()))


def main() -> None:
    if sys.argv[1:2] == ["export"]:
        from model.export_cli import main as export

        export()
    try:
        run_command("bc-train", Train, train, default=_defaults)
    except SystemExit as ended:
        if "WORLD_SIZE" not in os.environ:
            raise
        # A thread of torchrun's process group that returns while Python ends has aborted the process.
        end_process(ended.code if isinstance(ended.code, int) else int(ended.code is not None))
