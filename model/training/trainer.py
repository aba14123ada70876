"""Training: mean squared error, Adam, on the balanced index.

bc-train --epochs 10
"""

from __future__ import annotations

import contextlib
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch

from common import Skipped
from common.errors import counted
from common.interrupts import stop_signals
from common.locks import try_lock
from dataset import Samples
from model.config import TrainConfig
from model.device import choose_machine
from model.errors import RunError
from model.progress_bar import open_bar
from model.runs.checkpoint import LAST
from model.runs.provenance import data_fingerprint_of, provenance, training_of
from model.runs.run_arguments import run_argument
from model.runs.run_folder import (
    CONFIG,
    WEIGHTS,
    create_run,
    has_nothing_saved,
    load_config,
    refuse_existing_run,
    removed_unless_saved,
    run_name,
    weights_checksum,
    write_config,
)
from model.runs.run_inputs import init_of, relative_place
from model.runs.training_progress import Epoch, Listener
from model.training.distributed import group_of_processes, local_rank_of_process
from model.training.loop import TrainingLoop

MAY_CHANGE: Final = ("epochs", "patience", "device", "threads", "picture_memory_mb")
"""Settings that a resumed run may be given anew."""


@dataclass(frozen=True)
class Trained:
    """What came of a training."""

    run: Path
    epochs: list[Epoch]  # those of this call; only on the first of several ranks
    skipped: list[Skipped]  # pictures that do not decode, as far as this process met them
    notices: list[str]  # what a person should know before the run is used
    remarks: list[str]  # what could be better
    best_epoch: int  # whose weights drive
    is_stopped_early: bool


def train(
    index: Path | str,
    run: Path | str,
    config: TrainConfig | None = None,
    listeners: Sequence[Listener] = (),
    *,
    init: Path | str | None = None,
    resume: bool = False,
    show_progress: bool = True,
    figures: bool = True,
) -> Trained:
    """Train a network on `index` and keep it in the new folder `run`.

    `init` is a run whose weights it starts from. `resume` goes on with the run where it was stopped, or killed;
    the weights are then those of a run that never was, on the same processor with as many threads. One that was
    killed before anything of it was saved begins again from its seed.
    `figures` draws its curves, for which matplotlib is needed.
    Sets PyTorch's number of threads, and on a GPU its precision of float32, for this process.
    Ctrl-C ends the training after the batch that it is in, keeps what there is, and raises KeyboardInterrupt.
    Raises DatasetError if the index does not fit its logs, RunError if the run exists, cannot go on or diverges,
    if what it goes on with is damaged, or if the disk is full.
    """
    index, run, init = Path(index), Path(run), None if init is None else Path(init)
    stored = load_config(run) if resume else {}
    if resume:
        config = _resumed(run, stored, config)
    else:
        refuse_existing_run(run)
    config = config or TrainConfig()
    machine = choose_machine(config, local_rank_of_process())
    with (
        contextlib.closing(Samples(index)) as samples,
        group_of_processes(machine.device) as group,
        open_bar(is_shown=show_progress and group.is_first) as bar,
        contextlib.ExitStack() as stack,
    ):
        for listener in listeners:
            stack.callback(listener.close)
        on_gpu = [machine.device] if machine.device.type == "cuda" else []
        stack.enter_context(torch.random.fork_rng(devices=on_gpu))  # the caller's random numbers stay his
        loops: list[TrainingLoop] = []
        said = {"index": relative_place(run, index), **provenance(samples, config, machine, group.ranks)}
        if resume:
            _refuse_other_samples(run, stored, samples)
            group.first(lambda: stack.enter_context(_alone(run)))
            [begins] = group.any(has_nothing_saved(run))
            init = init_of(run, run.parent) if begins else None
        else:
            begins = True
            said |= _started_from(init, run)
            group.first(lambda: stack.enter_context(_created(run, said, lambda: any(x.has_learnt for x in loops))))
        loop = TrainingLoop(samples, run, config, machine, group, listeners, bar)
        loops.append(loop)
        loop.notices += _of_validation(samples, len(loop.validation), init)
        if begins:
            if init is not None:
                loop.start_from(init)
            if resume:
                group.first(loop.keep_history)
                group.first(lambda: write_config(run, {**stored, **said}))
            loop.begin()
        else:
            loop.go_back()
            if not loop.is_over:
                loop.remarks += _differences(run, stored, said["machine"])
                group.first(lambda: write_config(run, _gone_on(stored, said)))
        with stop_signals() as stopped:
            loop.train(stopped)
        if group.is_first and figures:
            loop.draw()
        return Trained(
            run,
            loop.history,
            loop.skipped,
            loop.notices,
            loop.remarks,
            loop.position.best_epoch,
            loop.is_stopped_early,
        )


def _resumed(run: Path, stored: dict[str, Any], config: TrainConfig | None) -> TrainConfig:
    """The settings that a stopped run goes on with."""
    before = training_of(stored, str(run / CONFIG))
    if config is None:
        return before
    wanted = config.as_dict()
    for name, value in before.as_dict().items():
        if name not in MAY_CHANGE and wanted[name] != value:
            flag = f"--{name.replace('_', '-')}"
            raise RunError(
                f"{run}: was begun with {flag} {value} and can only go on so; for {flag} {wanted[name]} train"
                f" another run from its weights: --init {run_argument(run)}"
            )
    return config


def _refuse_other_samples(run: Path, stored: dict[str, Any], samples: Samples) -> None:
    if data_fingerprint_of(stored, str(run / CONFIG)) != samples.fingerprint:
        has_weights = (run / WEIGHTS).exists()
        of_its_weights = (
            f", or train another run from its weights: --init {run_argument(run)}" if has_weights else ""
        )
        raise RunError(
            f"{samples.path}: not the samples that {run} was trained on; `bc-train --resume {run_argument(run)}"
            f" --index {shlex.quote(f'{samples.path.parent}-{run.name}')}` builds those again{of_its_weights}"
        )


def _differences(run: Path, stored: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """What a resumed run is not gone on with as it was begun."""
    before = stored.get("machine")
    before = before if isinstance(before, dict) else {}
    changed = [f"{name} {before.get(name)} to {now[name]}" for name in now if before.get(name) != now[name]]
    return (
        [f"{run}: goes on with other arithmetic ({', '.join(changed)}): other weights come of it"]
        if changed
        else []
    )


def _gone_on(stored: dict[str, Any], said: dict[str, Any]) -> dict[str, Any]:
    """The config of a resumed run: what it was begun with, and what it went on with."""
    before = stored.get("resumed")
    now = {name: said[name] for name in ("machine", "versions")}
    return {
        **stored,
        **{name: said[name] for name in ("index", "training")},
        "resumed": [*(before if isinstance(before, list) else []), now],
    }


def _of_validation(samples: Samples, held_out: int, init: Path | None) -> list[str]:
    """What is to be said of the frames held out, of which there are so many."""
    settings = samples.metadata["settings"]
    if not held_out:
        if settings.get("validation_share") or settings.get("validation"):
            return [
                f"{samples.path}: no frame is held out, so nothing tells how good the network is; give bc-index a"
                " smaller --block-s, or whole sessions with --validation SESSION"
            ]
        return []
    if init is None:
        return []
    from model.runs.trained_on import by_session, count_trained_on  # needs more packages than training does

    count = count_trained_on(by_session(samples.driving_view("validation")), samples, load_config(init))
    if count == 0:
        return []
    known = "does not say what it has learnt from" if count is None else f"has learnt from {count:,} of them"
    held = counted(held_out, "frame")
    return [f"{samples.path}: {held} held out, but {init} {known}: their errors say too little"]


def _started_from(init: Path | None, run: Path) -> dict[str, Any]:
    """Which weights a run starts from, and all that these have learnt from before."""
    if init is None:
        return {}
    before = load_config(init)
    earlier = before.get("init")
    data = earlier.get("data") if isinstance(earlier, dict) else None
    learnt = [before.get("data"), *(data if isinstance(data, list) else [])]
    return {
        "init": {
            "run": run_name(init),
            "place": relative_place(run, init),
            "weights_sha256": weights_checksum(init),
            "data": learnt,
        }
    }


@contextlib.contextmanager
def _created(run: Path, config: dict[str, Any], has_learnt: Callable[[], bool]) -> Iterator[None]:
    create_run(run, config)
    with removed_unless_saved(run, has_learnt), _alone(run):
        yield


@contextlib.contextmanager
def _alone(run: Path) -> Iterator[None]:
    """Let one process at a time train this run."""
    folder = run / LAST
    folder.mkdir(exist_ok=True)
    with (folder / ".lock").open("ab") as stream:
        for _ in range(50):  # whoever only looks whether it is locked holds it for a moment
            if try_lock(stream):
                break
            time.sleep(0.02)
        else:
            raise RunError(f"{run}: is being trained by another process; wait for it, or give another --name")
        yield
