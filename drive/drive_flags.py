"""The flags of `bc-drive`, and which of them go together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from common.command import check_port, flags_given
from common.errors import UsageError
from common.location_flag import LocationFlag
from recorder.sources.gymnasium_flags import GYM_FLAGS, GymFlags


@dataclass(frozen=True)
class Drive:
    """Drive the simulator with a trained network, and log the drive.

    Start the simulator in autonomous mode before or after; Ctrl-C brakes the car and finishes the log.

    bc-drive first --log run.mcap
    bc-drive first --simulator mountain --takeover me --open
    bc-drive racer --gym CarRacing-v3 --gym-action steering,throttle,brake --expert my_expert:drive
    """

    run: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """The run that drives, by name or folder; the newest one by default."""
    network: str | None = None
    """Code that a run's network is of, for a run of your own network: FILE.py:CLASS or package.module:CLASS."""
    log: LocationFlag | None = None
    """Where the drive is logged; by default DATE.mcap in --drives. With a URL (s3://BUCKET/drives/NAME.mcap) it is
    logged as drives/NAME.mcap, and copied when it is finished."""
    drives: LocationFlag = Path("drives")
    """Folder for the drive's log, or with --aggregate for all of them; with a URL (s3://BUCKET/drives) logs are
    made in drives/, and copied there."""
    simulator: Annotated[str | None, tyro.conf.arg(metavar="TRACK")] = None
    """Start the built-in simulator on a track (lake, mountain, random:SEED, hairpins:SEED), and end when it has
    driven."""
    laps: float = 1.0
    """Laps of the built-in simulator; with --aggregate, of each round of any simulator that reports its laps."""
    start: Annotated[float, tyro.conf.arg(metavar="METRES")] = 0.0
    """Where the built-in simulator's car begins, along the track."""
    real_time: bool = False
    """The built-in simulator goes no faster than the clock; otherwise it hurries from answer to answer."""
    takeover: Annotated[Literal["expert", "me"] | None, tyro.conf.arg(metavar="[expert|me]")] = None
    """Who takes over from the network. me: you, on a page of bc-web, by the first touch of a key, stick or wheel.
    expert: the simulator's, where the network leaves the lane, if the simulator sends its commands as the built-in
    one does. `bc-train --init RUN --takeovers LOG` learns from both."""
    open: bool = False
    """With --takeover me: open the page in a browser."""
    page: bool = True
    """With --takeover me: serve the page. A drive that a bc-web has started needs none of its own."""
    aggregate: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: not)")] = None
    """So often, train on what the expert did where it took over, and drive again (dataset aggregation). Without
    --simulator, each round drives the simulator that connects."""
    epochs: int = 5
    """Epochs of each training of --aggregate."""
    sessions: LocationFlag = Path("sessions")
    """Folder of the logs that the run was trained on, for --aggregate, and for the page of --takeover me."""
    speed: float = 10.0
    """Set speed in mph."""
    slow_in_curves: bool = False
    """Drive slower where the steering is far from straight."""
    smooth: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 0.0
    """Smooth the steering with this time constant; 0 sends what the network gives."""
    steering_rate: float = 0.0
    """The most that the steering (-1..1) may change in a second; 0: as fast as the network wants."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """The network's arithmetic; auto takes what is fastest on this processor."""
    viewer: Annotated[str, tyro.conf.arg(metavar="auto|window|web|ADDRESS|FILE.rrd|off")] = "auto"
    """Show the drive while it goes on: in a window, in a browser, in a viewer that runs already, or in a file.
    auto: in a window where there is a display."""
    server: Literal["eventlet", "threading"] = "eventlet"
    """The server that the simulator connects to."""
    host: str = "127.0.0.1"
    """Address to listen on; other machines are let in by 0.0.0.0."""
    port: int = 4567
    """Port to listen on; the simulator connects to 4567."""
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car that is driven, as in bc-record; by default the one of the run's sessions."""
    environment: tyro.conf.OmitArgPrefixes[GymFlags] = field(default_factory=GymFlags)
    seed: int = 0
    """Seed of the first reset of --gym's environment."""
    runs: LocationFlag = Path("runs")
    """Where runs are kept; those that --aggregate trains are made in runs/ and copied there, if that is a URL."""
    force: bool = False
    """Replace a log of the same name, and the file of --viewer."""


def with_default_driver(words: Sequence[str]) -> list[str]:
    """The words of a command line, in which a bare `--takeover` is `--takeover expert`."""
    completed = list(words)
    for place in reversed([place for place, word in enumerate(words) if word == "--takeover"]):
        if words[place + 1 : place + 2] not in (["expert"], ["me"]):
            completed.insert(place + 1, "expert")
    return completed


def refuse_contradictions(config: Drive) -> None:
    """Raise UsageError for flags that would be passed over, and for what is no port."""
    if config.log is not None and (flags := flags_given(config, "drives")):
        raise UsageError(f"{flags}: is for a log that --log does not name: give one of both")
    if config.environment.gym is not None:
        others = ("simulator", "laps", "start", "real_time", "takeover", "aggregate", "server", "host", "port")
        if flags := flags_given(config, *others, "epochs", "sessions"):
            raise UsageError(
                f"{flags}: not with --gym, which neither connects to a port nor knows where its car is"
            )
        if config.seed < 0:
            raise UsageError(f"--seed {config.seed}: a whole number from 0 on was expected")
        return
    if flags := flags_given(config.environment, *GYM_FLAGS) or flags_given(config, "seed"):
        raise UsageError(f"{flags}: only with --gym ID")
    if config.port:  # 0: a free one
        check_port("--port", config.port)
    if config.takeover != "me" and (flags := flags_given(config, "open", "page")):
        raise UsageError(f"{flags}: only with --takeover me")
    if config.takeover == "me" and config.aggregate is not None:
        raise UsageError(
            "--aggregate: drives by itself; with --takeover me, drive first, and then `bc-train --init RUN"
            " --takeovers LOG`"
        )
    if not 0 <= config.start < math.inf:
        raise UsageError(f"--start {config.start:g}: a number of metres, 0 or more, was expected")
    if config.aggregate is not None and (flags := flags_given(config, "start")):
        raise UsageError(f"{flags}: not with --aggregate, whose rounds begin at the start")
    if config.simulator is None and (flags := flags_given(config, "real_time", "start")):
        raise UsageError(f"{flags}: only with the built-in simulator: give --simulator TRACK as well")
    if config.simulator is None and config.aggregate is None and (flags := flags_given(config, "laps")):
        raise UsageError(f"{flags}: only with --simulator TRACK or --aggregate N: else it drives until Ctrl-C")
    if config.simulator is not None and (flags := flags_given(config, "car")):
        raise UsageError(f"{flags}: the built-in simulator's car is known; leave it out")
    if config.simulator is not None and (flags := flags_given(config, "host", "port")):
        raise UsageError(f"{flags}: the built-in simulator runs on this machine and a free port; leave it out")
    if config.aggregate is None and (flags := flags_given(config, "epochs")):
        raise UsageError(f"{flags}: only with --aggregate N")
    if config.aggregate is None and config.takeover != "me" and (flags := flags_given(config, "sessions")):
        raise UsageError(f"{flags}: only with --aggregate N, or --takeover me")
    others = ("log", *(() if config.viewer == "off" else ("viewer",)), "precision", "force")
    if config.aggregate is not None and (flags := flags_given(config, *others)):
        raise UsageError(
            f"{flags}: not with --aggregate, which names its logs, replaces nothing, shows a table and takes the"
            " fastest arithmetic; leave it out"
        )
