"""`bc-sim`: runs the simulator in a separate process, which connects to `bc-drive` as Udacity's simulator does."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common import UserError
from common.command import DONE, FAILED, check_port, flags_given, run_command, usage_errors
from common.errors import UsageError, counted
from common.output import print_message, print_result
from common.progress import progress_bar, track
from simulator.driving.drive_limits import MAX_LAPS, MAX_SPEED_MPH
from simulator.protocol.client import NoHostError, SimulatorClient, WaitTimeoutError


@dataclass(frozen=True)
class Sim:
    """Connect to bc-drive as the Udacity simulator does.

    Drives the built-in track --track; or, with --replay, sends recorded pictures as telemetry.
    """

    track: Annotated[str, tyro.conf.arg(metavar="TRACK")] = "lake"
    """lake, mountain, random:SEED, or hairpins:SEED."""
    laps: float = 1.0
    """Laps to drive."""
    start: float = 0.0
    """Start, in metres along the track."""
    rate: float = 25.0
    """Telemetries a second of simulated time; it must divide 50."""
    real_time: bool = False
    """Run no faster than the clock; otherwise only the answers limit the speed."""
    tell_world: bool = False
    """Also send the clock, place, laps and the expert's command."""
    expert_speed: float = 10.0
    """The expert's set speed in mph, for --tell-world."""
    leave_off_road: bool = False
    """Leave the car off the road; put it back after 15 s without progress."""
    replay: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Send the centre pictures of this Udacity recording, in order."""
    count: int | None = None
    """Pictures of --replay to send; all by default."""
    host: str = "127.0.0.1"
    """Address of bc-drive."""
    port: int = 4567
    """Port of bc-drive."""
    wait: float = 60.0
    """Seconds to wait for bc-drive."""
    json: bool = False
    """Print the result as one line of JSON."""


def sim(config: Sim) -> int:
    check_port("--port", config.port)
    if not 0 <= config.wait < math.inf:
        raise UsageError(f"--wait {config.wait:g}: give a number of seconds")
    if config.count is not None and config.replay is None:
        raise UsageError(f"--count {config.count}: only with --replay FOLDER")
    if config.count is not None and config.count < 1:
        raise UsageError(f"--count {config.count}: give a number of pictures above 0")
    client = SimulatorClient(config.host, config.port, wait_s=config.wait)
    try:
        return _run_replay(config, client) if config.replay is not None else _run_drive(config, client)
    except WaitTimeoutError as error:
        raise UserError(f"{error}; start `bc-drive` first, or wait longer with --wait") from None
    except NoHostError as error:
        raise UserError(f"--host {error}; give the machine where `bc-drive` runs, such as 127.0.0.1") from None


def _run_drive(config: Sim, client: SimulatorClient) -> int:
    import cv2

    from simulator.driving.expert import Expert
    from simulator.driving.recovery_driving import steps_each
    from simulator.driving.simulation import Simulation
    from simulator.protocol.autonomous_mode import GIVE_UP_S, drive_autonomously

    if not 0 < config.expert_speed <= MAX_SPEED_MPH:
        raise UsageError(
            f"--expert-speed {config.expert_speed:g}: give a set speed above 0 mph and up to {MAX_SPEED_MPH} (the"
            " car reaches 30)"
        )
    if not 0 < config.laps <= MAX_LAPS:
        raise UsageError(f"--laps {config.laps:g}: give a number above 0 and up to {MAX_LAPS:,}")
    if not 0 <= config.start < math.inf:
        raise UsageError(f"--start {config.start:g}: give a number of metres, 0 or more")
    with usage_errors(ValueError):
        steps_each(config.rate)
    cv2.setNumThreads(1)  # the network that drives needs the other cores more
    try:
        simulation = Simulation(config.track)
    except ValueError as error:
        raise UserError(f"--track {config.track}: {error}") from None
    if not config.json:  # with --json, a program such as bc-drive or bc-eval has started bc-sim
        print_message(f"bc-sim: connecting to {client.url}")
    if not config.real_time and not config.tell_world:
        print_message(
            "bc-sim: this simulator runs faster than the clock that bc-drive uses: give --real-time or"
            " --tell-world for correct distances and times in the log"
        )
    expert = Expert(simulation.track.line, config.expert_speed) if config.tell_world else None
    with progress_bar() as bar:
        task = bar.add_task(f"driving {config.track}", total=round(config.laps * 1000), note="")
        driven = drive_autonomously(
            simulation,
            client,
            laps=config.laps,
            start_m=config.start,
            rate_hz=config.rate,
            real_time=config.real_time,
            expert=expert,
            leave_off_road=config.leave_off_road,
            progress=lambda laps: bar.update(task, completed=round(laps * 1000)),
            lost=lambda: print_message(f"bc-sim: disconnected; waiting for a server for {config.wait:g} s"),
        )
    if driven.gave_up:
        print_message(f"bc-sim: given up: the car made no progress for {GIVE_UP_S:g} s of simulated time")
    if config.json:
        print_result(json.dumps(driven.as_dict()))
    else:
        measures = driven.measures
        print_result(
            f"{driven.track}: {measures.laps:.2f} laps in {measures.elapsed_s:,.0f} s of simulated time,"
            f" {counted(measures.interventions, 'intervention')}, autonomy {measures.autonomy_percent:.1f} %,"
            f" distance from the centre line {measures.mean_offset:.2f} (largest {measures.max_offset:.2f})"
            f" of the road's half width, {measures.mean_speed_mph:.1f} mph"
        )
    return DONE


def _run_replay(config: Sim, client: SimulatorClient) -> int:
    from simulator.protocol.replay import pictures_of, replay

    assert config.replay is not None  # noqa: S101
    if config.tell_world:
        raise UsageError("--tell-world: the world of --replay's pictures is unknown; leave out one of the two")
    driven = ("track", "laps", "start", "rate", "real_time", "leave_off_road", "expert_speed")
    if flags := flags_given(config, *driven):
        raise UsageError(f"{flags}: only for driving, but --replay only sends pictures; leave out {flags}")
    pictures = pictures_of(config.replay)[: config.count]
    print_message(f"bc-sim: connecting to {client.url}")
    start_s = 0.0

    def jpegs() -> Iterator[bytes]:
        nonlocal start_s
        start_s = time.perf_counter()  # the first picture is read when the server is connected
        for path in track(pictures, "sending", len(pictures)):
            yield path.read_bytes()

    replay(client, jpegs())
    seconds = time.perf_counter() - start_s
    answers = client.steers + client.manuals  # a server that only listens answers with `manual`
    result = {
        "telemetries": client.telemetries,
        "answers": answers,
        "unreadable": client.bad_steers,
        "answers_per_s": round(answers / seconds),
    }
    if config.json:
        print_result(json.dumps(result))
    else:
        print_result(
            f"{counted(client.telemetries, 'telemetry', 'telemetries')}, {counted(answers, 'answer')}"
            f" ({client.bad_steers:,} unreadable), {result['answers_per_s']:,} a second"
        )
    return DONE if answers == client.telemetries else FAILED


def main() -> None:
    run_command("bc-sim", Sim, sim)


if __name__ == "__main__":  # bc-drive and bc-eval start bc-sim in this way
    main()
