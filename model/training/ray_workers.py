"""One network trained by workers on a Ray cluster: the loop that torchrun starts, in actors instead of processes.

    bc-train --ray 4

Each worker is a rank of one torch.distributed group (`model.training.distributed`). If one dies, all are started
again and go on from the checkpoint, as `--resume` does: to the same weights.
"""

from __future__ import annotations

import itertools
import os
import socket
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from rich.progress import Progress

from common.allowed_places import allow_places, places_of
from common.errors import UserError, counted, printable
from common.location import Location
from common.output import print_message
from common.ray_cluster import NOTICE_AFTER_S, ClusterError, connection, package_versions, refuse_other_node
from model.config import TrainConfig
from model.network.names import is_own
from model.network.own_code import load_code
from model.progress_bar import open_bar
from model.runs.run_folder import CONFIG
from model.runs.training_progress import Epoch, Listener, Step
from model.training.distributed import FirstRankError
from model.training.listeners import Listeners
from model.training.trainer import Trained, train

MAX_RESTARTS: Final = 5
"""A training whose workers die for the sixth time is given up; it can be resumed."""

_POLL_S: Final = 0.5
_NOTICE_EVERY_S: Final = 60.0
MAX_LOCAL_START_S: Final = 600.0
"""Workers on a cluster of this machine alone, where nobody else has work, are there by then, or never."""
_STOP_S: Final = 60.0


class _WorkerLostError(Exception):
    """A worker died, or lost another one."""


@dataclass(frozen=True)
class _Call:
    """The arguments with which each rank calls `train`."""

    index: Location
    run: Path
    config: TrainConfig
    init: Path | None
    like: Path | None
    resume: bool
    places: Sequence[Location]  # which index and run may name (`common.allowed_places`)


class _Worker:
    """A rank, on a node, and the listener of its training: it keeps the progress until the driver fetches it. Ray
    calls `progress` and `stop` in other threads than `train`."""

    def __init__(self, versions: Mapping[str, str], folder: Path) -> None:
        self._refused: UserError | None = None
        self._progress: list[Step | Epoch] = []
        self._lock = threading.Lock()
        self._stop = threading.Event()
        try:
            refuse_other_node(versions, folder)
        except UserError as error:
            self._refused = error

    def place(self) -> tuple[str, int]:
        """This node's address, and a port that is free on it."""
        import ray

        with socket.socket() as probe:
            probe.bind(("", 0))
            return ray.util.get_node_ip_address(), probe.getsockname()[1]

    def train(self, rank: int, ranks: int, place: tuple[str, int], call: _Call) -> Trained | Exception | None:
        """The result, or the error that its user can mend; None if it was stopped."""
        if self._refused is not None:
            return self._refused
        # LOCAL_RANK: Ray shows each worker no GPU but its own
        host, port = place
        group = {"RANK": rank, "WORLD_SIZE": ranks, "LOCAL_RANK": 0, "MASTER_ADDR": host, "MASTER_PORT": port}
        os.environ.update({name: str(value) for name, value in group.items()})
        try:
            allow_places(*call.places)
            if call.resume and is_own(call.config.network):
                load_code(call.config.network)
            return train(
                call.index,
                call.run,
                call.config,
                [self],
                init=call.init,
                like=call.like,
                resume=call.resume,
                show_progress=False,
                stop=self._stop,
            )
        except (UserError, OSError, MemoryError) as error:
            return error
        except KeyboardInterrupt:
            return None

    def step(self, step: Step | Epoch) -> None:
        with self._lock:
            self._progress.append(step)

    def epoch(self, epoch: Epoch) -> None:
        self.step(epoch)

    def close(self) -> None:
        """The driver closes its own."""

    def progress(self) -> list[Step | Epoch]:
        """The progress since the last call."""
        with self._lock:
            taken, self._progress = self._progress, []
            return taken

    def stop(self) -> None:
        self._stop.set()


def train_on_cluster(
    workers: int,
    address: str,
    index: Location,
    run: Path,
    config: TrainConfig,
    listeners: Sequence[Listener] = (),
    *,
    init: Path | None = None,
    like: Path | None = None,
    resume: bool = False,
) -> Trained:
    """`train` by so many workers of a cluster (`common.ray_cluster`), which all see `index` and `run` by these
    paths. Each takes the processors that `config.threads` names, or one, and a GPU where the cluster has enough.

    Raises what `train` does, ClusterError where no cluster can be reached or workers died too often. Ctrl-C ends
    the training after the batch that it is in.
    """
    call = _Call(index, run, config, init, like, resume, places_of(index, run))
    notices: list[str] = []
    guarded = Listeners(listeners, notices)
    with connection(address) as ray, open_bar(is_shown=True) as bar:
        is_on_gpu = config.device == "cuda" or (
            config.device == "auto" and ray.cluster_resources().get("GPU", 0) >= workers
        )
        actor = ray.remote(_Worker).options(
            num_cpus=config.threads or 1, num_gpus=int(is_on_gpu), max_concurrency=2
        )
        try:
            for attempt in itertools.count():
                try:
                    trained = _attempt(ray, actor, workers, call, guarded, bar, is_local=address == "local")
                    return replace(trained, notices=[*trained.notices, *notices])
                except _WorkerLostError as error:
                    why = printable(" ".join(str(error).split())[:300])
                    if attempt == MAX_RESTARTS:
                        raise ClusterError(f"{run}: workers were lost {attempt + 1} times: {why}") from None
                    print_message(f"bc-train: a worker was lost; going on from the checkpoint ({why})")
                    call = replace(call, resume=(run / CONFIG).exists())
        finally:
            guarded.close()
    raise AssertionError("it ends in the loop")


def _attempt(
    ray: Any, actor: Any, workers: int, call: _Call, listeners: Listeners, bar: Progress, *, is_local: bool
) -> Trained:
    """Train from where the run is. Raises _WorkerLostError if a worker dies."""
    processors = call.config.threads or 1
    total = ray.cluster_resources().get("CPU", 0)
    if is_local and workers * processors > total:
        wanted = f"{counted(workers, 'worker')} of {counted(processors, 'processor')}"
        raise ClusterError(f"--ray: {wanted}, but this machine has {total:g}; give fewer workers, or --threads")
    ranks = [actor.remote(package_versions(), Path.cwd()) for _ in range(workers)]
    results: list[Any] = []
    try:
        place = _place(ray, ranks, processors, is_local=is_local)
        results = [rank.train.remote(number, workers, place, call) for number, rank in enumerate(ranks)]
        pending = results
        while pending:
            ready, pending = ray.wait(pending, timeout=_POLL_S)
            _pass_on(ray.get(ranks[0].progress.remote()), call.config.epochs, listeners, bar)
            for result in map(ray.get, ready):
                if isinstance(result, Exception) and not isinstance(result, FirstRankError):
                    raise result
        trained = ray.get(results[0])
    except KeyboardInterrupt:
        for rank in ranks:
            rank.stop.remote()
        if results:
            ray.wait(results, num_returns=workers, timeout=_STOP_S)
        raise
    except ray.exceptions.RayError as error:
        raise _WorkerLostError(str(error)) from None
    finally:
        for rank in ranks:
            ray.kill(rank)
    if trained is None:  # its node stopped it
        raise _WorkerLostError("it was stopped on its node")
    assert isinstance(trained, Trained)  # noqa: S101
    return trained


def _place(ray: Any, ranks: Sequence[Any], processors: int, *, is_local: bool) -> tuple[str, int]:
    """The address and port at which the ranks meet, once the cluster has room for all of them; each takes so many
    processors. Raises ClusterError where they do not start on a cluster of this machine alone."""
    workers = f"{counted(len(ranks), 'worker')} of {counted(processors, 'processor')}"
    places = [rank.place.remote() for rank in ranks]
    began_s, notices = time.monotonic(), 0
    while len(ray.wait(places, num_returns=len(places), timeout=_POLL_S)[0]) < len(places):
        waited_s = time.monotonic() - began_s
        if waited_s > NOTICE_AFTER_S + notices * _NOTICE_EVERY_S:
            free, total = (of.get("CPU", 0) for of in (ray.available_resources(), ray.cluster_resources()))
            print_message(
                f"bc-train: waiting for {workers} to start, or for room for them: {free:g} of"
                f" {counted(round(total), 'processor')} are free"
            )
            notices += 1
        if is_local and waited_s > MAX_LOCAL_START_S:
            raise ClusterError(
                f"--ray: {workers} did not start within {MAX_LOCAL_START_S / 60:.0f} minutes; this machine may be"
                " busy with other programs: end some, or train without --ray"
            )
    place: tuple[str, int] = ray.get(places)[0]
    return place


def _pass_on(progress: Sequence[Step | Epoch], epochs: int, listeners: Listeners, bar: Progress) -> None:
    """Pass the progress of the first rank on to the driver's listeners and bar."""
    for each in progress:
        if isinstance(each, Epoch):
            listeners.epoch(each)
            continue
        listeners.step(each)
        if not bar.tasks:
            bar.add_task("", note="")
        bar.update(
            bar.tasks[0].id,
            description=f"training (epoch {each.epoch:,}/{epochs:,})",
            total=epochs * each.batches,
            completed=(each.epoch - 1) * each.batches + each.batch,
            note=f"loss {each.training_loss:.4f}  {each.samples_per_s:,.0f} samples/s",
        )
