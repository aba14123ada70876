"""Dataset aggregation: drive, let the expert take over, train on what it did, drive again.

The method is that after Ross, Gordon and Bagnell 2011 (arXiv 1011.0686), with the expert driving only where it
has to, as in Kelly et al. 2019 (HG-DAgger, arXiv 1810.02890).
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import torch

from common.location import Location
from dataset import DatasetError, build_index
from drive.config import DriveConfig
from drive.errors import DriveError
from drive.evaluation.external_simulator import ExternalSimulator
from drive.evaluation.simulator_process import BuiltInSimulator
from model import TrainConfig, load_pilot, train
from model.runs.car_of_run import refuse_other_steering
from model.runs.reproduce import logs_with_takeovers
from model.runs.run_folder import CONFIG, run_name
from recorder.log.session_car import UDACITY
from recorder.server.telemetry_server import ServerMode

MAX_ROUNDS: Final = 100


@dataclass(frozen=True)
class AggregationRound:
    """One drive of an aggregation, in which the expert could take over."""

    run: str  # the run that drove
    log: Path
    laps: float | None  # None where the simulator does not send them
    interventions: int  # the expert took over, or the simulator put the car back
    autonomy_percent: float | None


class Aggregation:
    """Drives `simulator` and trains by turns, `rounds` times: the takeovers are indexed with what `run` was
    trained on, and its weights are trained on.

    Everything is named after the run and the track: drives/RUN-TRACK-0.mcap, the index index-RUN-TRACK, and
    runs/RUN-TRACK-1 and so on; with a simulator that connects by itself, TRACK is "connected". Raises UserError
    at once if one of these exists, a log of the run is gone, or `config.car` has another angle at steering 1.
    """

    def __init__(
        self,
        run: Path,
        simulator: BuiltInSimulator | ExternalSimulator,
        config: DriveConfig,
        rounds: int,
        training: TrainConfig,
        *,
        sessions: Location,
        drives: Path,
        runs: Path,
    ) -> None:
        """`sessions` has the logs that the run has learnt from; `drives` those of earlier aggregations."""
        check_rounds(rounds)
        refuse_other_steering(run, (config.car or UDACITY).max_steering_deg, "the car that is driven")
        self._simulator = simulator
        self._config = replace(config, takeover=True)
        self._training = training
        self._threads = torch.get_num_threads()  # a pilot drives on one
        self._sessions, self._settings = logs_with_takeovers(run, [], sessions, drives)
        self._warned: set[str] = set()
        name = f"{run_name(run)}-{simulator.name}"
        self._index = runs.parent / f"index-{name}"
        self._logs = [drives / f"{name}-{number}.mcap" for number in range(rounds + 1)]
        self._runs = [run, *(runs / f"{name}-{number}" for number in range(1, rounds + 1))]
        if in_the_way := self._left():
            raise DriveError(f"exist already, of an aggregation before this one; move them away: {in_the_way}")

    def rounds(
        self, mode: ServerMode, notify: Callable[[str], None], warn: Callable[[str], object]
    ) -> Iterator[AggregationRound]:
        """Give each drive as it is done: the first with the run as it is, one more after every training.

        `notify` gets a line for each step, and how to go on if it is stopped; `warn` gets one, once, for every log
        that an index leaves out or holds in part, and for pictures that training leaves out. Raises DriveError
        where the simulator fails, KeyboardInterrupt if it was stopped.
        """
        trained = 0  # the last run that is
        for number, (run, log) in enumerate(zip(self._runs, self._logs, strict=True)):
            try:
                if number:
                    notify(f"training {run}")
                    self._train(run, self._runs[trained], self._logs[:number], warn)
                    trained = number
                notify(
                    f"{run_name(run)} drives {self._simulator.description}, the expert takes over outside the lane"
                )
                done = self._drive(run, log, mode)
            except KeyboardInterrupt:
                notify(self._way_on(number, trained))
                raise
            if not done.interventions and number + 1 < len(self._runs):
                notify("the expert had nothing to do: the next training learns nothing new")
            yield done

    def _left(self) -> str:
        """The output files that exist already, quoted for a shell."""
        made = (*self._logs, self._index, *self._runs[1:])
        return shlex.join(str(path) for path in made if os.path.lexists(path))

    def _way_on(self, number: int, trained: int) -> str:
        """The notice of how to go on after a round that was stopped; `trained` is the last run that is."""
        run, log = self._runs[number], self._logs[number]
        first = ""
        if trained < number and (run / CONFIG).is_file():
            resume = shlex.join(("bc-train", "--resume", str(run), "--index", str(self._index)))
            first, trained = f"finish {run} with `{resume}`; then ", number
        elif trained == number and log.exists():
            first = f"{log} holds the drive so far; "
        if not trained:
            left = self._left()
            return f"{first}to begin again, move away {left}" if left else "nothing was driven yet"
        drive = shlex.join(("bc-drive", str(self._runs[trained]), *self._simulator.flags))
        more = len(self._runs) - 1 - trained
        aggregate = f"{drive} --aggregate {more}" if more else f"{drive} --takeover"
        return f"{first}go on with `{aggregate}` and the other flags as before"

    def _train(self, run: Path, before: Path, drives: list[Path], warn: Callable[[str], object]) -> None:
        torch.set_num_threads(self._threads)
        try:
            logs = [*self._sessions, *drives]
            notices = build_index(logs, self._index, self._settings, leave_out_unreadable=True).notices
            for notice in notices:
                if notice not in self._warned:
                    warn(notice)
            self._warned.update(notices)
            trained = train(self._index, run, self._training, init=before)
            for skipped in trained.skipped:
                for line in skipped.lines():
                    warn(f"skipped {line}")
        except DatasetError as error:
            raise DriveError(f"{self._index}: {error}") from None

    def _drive(self, run: Path, log: Path, mode: ServerMode) -> AggregationRound:
        pilot = load_pilot(run, device=self._training.device)
        pilot.warm_up()
        summary = self._simulator.drive(pilot, self._config, log, mode)
        return AggregationRound(run_name(run), log, summary.laps, summary.interventions, summary.autonomy_percent)


def check_rounds(rounds: int) -> None:
    """Raises DriveError for a number of rounds that makes no sense."""
    if not 1 <= rounds <= MAX_ROUNDS:
        raise DriveError(f"--aggregate {rounds}: how often to drive and train, 1 to {MAX_ROUNDS}")
