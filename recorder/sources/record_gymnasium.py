"""Records an expert in a Gymnasium environment in a log."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

from common import Skipped
from common.command import usage_errors
from common.errors import UsageError, counted
from common.files import refuse_existing
from common.interrupts import stop_signals
from common.progress import progress_bar
from common.versions import version_of
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError
from recorder.log.log_time import BREAK_NS
from recorder.log.meant_gaps import MeantGap
from recorder.log.session_car import Car, metadata_of
from recorder.log.writer import LogWriter
from recorder.sources.built_in_simulator import CLOCK_START_NS
from recorder.sources.gymnasium_car import GymnasiumCar
from recorder.sources.imported_rows import Imported
from recorder.sources.settings import GymFlags, check_rate
from simulator.driving.expert import Wandering


@dataclass(frozen=True)
class GymRecording:
    """The settings of a recording: the environment, its expert, and how it is recorded.

    With `wander`, the sent steering wanders around the expert's, so that the expert has errors to correct. The log
    has the expert's own steering (Laskey et al. 2017, DART: Noise Injection for Robust Imitation Learning).
    """

    environment: GymFlags
    seed: int = 0  # of the first episode's reset, and of the wandering
    rate_hz: float | None = None  # rows a second; must divide the environment's rate; None: each step is a row
    wander: float = 0.0  # standard deviation, for steering -1..1
    car: Car | None = None  # the environment's


def record_gymnasium(recording: GymRecording, log: Path, *, overwrite: bool = False) -> Imported:
    """Record an expert's episodes to `log`: the camera's pictures, and the expert's action for each.

    Ctrl-C ends the recording. Recorded rows are kept, also if the environment or the expert fails.

    Raises UsageError for invalid flags, RecordingError for an environment or an expert that cannot be recorded,
    UserError if `log` exists and `overwrite` is off.
    """
    refuse_existing(log, overwrite)
    check_recording(recording)
    with stop_signals() as stopped, GymnasiumCar(recording.environment) as car:
        steps_hz = car.rate_hz
        every = _steps_a_row(recording.rate_hz, steps_hz)
        count, most = recording.environment.episodes, car.max_steps
        time_ns, rows, rewards = CLOCK_START_NS, 0, list[float]()
        another_episode = MeantGap(BREAK_NS / 1e9, "another episode begins")
        with (
            LogWriter(log, _metadata(recording, car), overwrite=overwrite, live=True) as writer,
            progress_bar() as bar,
        ):
            task = bar.add_task(f"recording {car.name}", total=count, note="episodes")
            for number in range(count):
                seed = recording.seed + number
                wandering = Wandering(recording.wander, seed)
                moment, step, reward = car.reset(seed), 0, 0.0
                while not (moment.end or stopped.is_set()):
                    before, action = moment, car.expert_action(moment)
                    moment = car.step(car.actions.turned(action, wandering.at(step / steps_hz)))
                    if step % every == 0:  # written only now: an environment that fails at once leaves no log
                        row_ns = time_ns + round(step * 1e9 / steps_hz)
                        state = VehicleState(**vars(car.actions.command(action)), speed_mph=before.speed_mph)
                        writer.picture("center", row_ns, rows, before.jpeg(), before.size)
                        writer.vehicle(row_ns, rows, state, another_episode if number and not step else None)
                        rows += 1
                    step, reward = step + 1, reward + moment.reward
                    bar.update(task, completed=number + (step / most if most else 0.0))
                if stopped.is_set():
                    break
                end_ns = time_ns + round(step * 1e9 / steps_hz)
                writer.event(end_ns, f"episode {number + 1}, seed {seed}: {moment.end}, reward {reward:,.1f}")
                rewards.append(reward)
                time_ns = end_ns + BREAK_NS
            if not rows:
                writer.discard()
                raise RecordingError(f"{log}: stopped before a row was recorded")
    mean = f", with a reward of {sum(rewards) / len(rewards):,.1f} on average" if rewards else ""
    notice = f"{'stopped: ' if stopped.is_set() else ''}{counted(len(rewards), 'episode')} driven to the end{mean}"
    return Imported(log, rows, rows, Skipped(), [*writer.notices, notice])


def check_recording(recording: GymRecording) -> None:
    """Raise UsageError, which names the flag, for settings that are invalid in every environment."""
    if recording.environment.expert is None:
        raise UsageError("an expert is recorded: give a function of your own by --expert MODULE:FUNCTION")
    if not 0.0 <= recording.wander < math.inf:
        raise UsageError(f"--wander {recording.wander:g}: expected a standard deviation, 0 or more")
    if recording.seed < 0:
        raise UsageError(f"--seed {recording.seed}: expected a whole number from 0 on")
    with usage_errors(RecordingError):
        check_rate(recording.rate_hz)


def _steps_a_row(rows_hz: float | None, steps_hz: float) -> int:
    """Steps of the environment for each row. Raises RecordingError if this is not a whole number."""
    steps = 1 if rows_hz is None else round(steps_hz / rows_hz)
    if steps < 1 or (rows_hz is not None and abs(steps * rows_hz - steps_hz) > 1e-6 * steps_hz):
        raise RecordingError(f"--rate {rows_hz:g}: it must divide the environment's {steps_hz:g} steps a second")
    return steps


def _metadata(recording: GymRecording, car: GymnasiumCar) -> dict[str, str]:
    return metadata_of(recording.car) | {
        "source": "gymnasium",
        "simulator": car.name,
        "driver": str(recording.environment.expert),
        "clock": f"{car.rate_hz:g} steps a second of the environment's own time",
        "gym.args": json.dumps(car.settings.args),
        "gym.action": car.actions.text,
        "gym.seed": str(recording.seed),
        "gym.wander": f"{recording.wander:g}",
        "gym.version": version_of("gymnasium"),
    }
