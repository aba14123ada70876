"""The flags of `bc-drive`, and the combinations that are refused."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal

import tyro

from common.command import check_port, flags_given
from common.errors import UsageError
from recorder.sources.settings import GYM_FLAGS, REMOVED_GYM_FLAGS, GymFlags

_PAGE_FLAGS: Final = ("open", "page", "sessions")


@dataclass(frozen=True)
class Drive:
    """Drive the simulator with a trained network, and log the drive.

    Start the simulator in autonomous mode before or after; Ctrl-C brakes the car and finishes the log.

    bc-drive first --log run.mcap
    bc-drive first --simulator mountain --takeover me --open
    """

    RARE: ClassVar[str] = (
        "network drives start real_time page sessions smooth steering_rate device precision host port seed runs"
    )
    REMOVED: ClassVar[Mapping[str, str]] = {
        "--aggregate": "drive with --takeover --log LOG.mcap, then `bc-train continue RUN --takeovers LOG.mcap`",
        "--server": "eventlet serves; leave it out",
        **REMOVED_GYM_FLAGS,
    }
    run: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """Name or folder; by default the newest."""
    network: str | None = None
    """Your network's code: FILE.py:CLASS or MODULE:CLASS."""
    log: Path | None = None
    """The drive's log; by default DATE.mcap in --drives."""
    drives: Path = Path("drives")
    """Folder of the drives' logs."""
    simulator: Annotated[str | None, tyro.conf.arg(metavar="TRACK")] = None
    """Built-in: lake, mountain, random:SEED, or hairpins:SEED."""
    laps: float = 1.0
    """Laps with --simulator."""
    start: Annotated[float, tyro.conf.arg(metavar="METRES")] = 0.0
    """Where to start with --simulator."""
    real_time: bool = False
    """Run --simulator no faster than the clock."""
    takeover: Annotated[Literal["expert", "me"] | None, tyro.conf.arg(metavar="[expert|me]")] = None
    """Let the expert take over before the car leaves its lane, or you in a browser (me)."""
    open: bool = False
    """With --takeover me: open the browser."""
    page: bool = True
    """With --takeover me: serve no page, but use that of a running bc-web."""
    sessions: Path = Path("sessions")
    """The run's sessions, for the page of --takeover me."""
    speed: float = 10.0
    """Set speed in mph."""
    slow_in_curves: bool = False
    """Drive slower in curves."""
    smooth: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 0.0
    """Time constant of the steering's smoothing; 0: none."""
    steering_rate: float = 0.0
    """Largest change of the steering in a second; 0: no limit."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto: a GPU if there is one."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """Arithmetic; auto: the fastest."""
    viewer: Annotated[str, tyro.conf.arg(metavar="auto|window|web|ADDRESS|FILE.rrd|off")] = "auto"
    """Show the drive in Rerun; auto: a window if there is a display."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 admits other machines."""
    port: int = 4567
    """Port to listen on."""
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car, as in bc-record; by default that of the run."""
    environment: tyro.conf.OmitArgPrefixes[GymFlags] = field(default_factory=GymFlags)
    seed: int = 0
    """Seed of --gym's first episode."""
    runs: Path = Path("runs")
    """The runs."""
    force: bool = False
    """Replace the log, and the file of --viewer."""


def with_default_driver(words: Sequence[str]) -> list[str]:
    """The words of a command line, with `--takeover expert` for a bare `--takeover`."""
    completed = list(words)
    for place in reversed([place for place, word in enumerate(words) if word == "--takeover"]):
        if words[place + 1 : place + 2] not in (["expert"], ["me"]):
            completed.insert(place + 1, "expert")
    return completed


def refuse_contradictions(config: Drive) -> None:
    if config.log is not None and (flags := flags_given(config, "drives")):
        raise UsageError(f"{flags}: not needed with --log, which names the log: give one of them")
    if config.environment.gym is not None:
        others = ("simulator", "laps", "start", "real_time", "takeover", *_PAGE_FLAGS, "host", "port")
        if flags := flags_given(config, *others):
            raise UsageError(
                f"{flags}: not with --gym: an environment has no port and does not report its car's position"
            )
        if config.seed < 0:
            raise UsageError(f"--seed {config.seed}: expected a whole number from 0 on")
        return
    if flags := flags_given(config.environment, *GYM_FLAGS) or flags_given(config, "seed"):
        raise UsageError(f"{flags}: only with --gym ID")
    if config.port:  # 0: any free port
        check_port("--port", config.port)
    if config.takeover != "me" and (flags := flags_given(config, *_PAGE_FLAGS)):
        raise UsageError(f"{flags}: only with --takeover me")
    if not 0 <= config.start < math.inf:
        raise UsageError(f"--start {config.start:g}: expected a number of metres, 0 or more")
    if config.simulator is None and (flags := flags_given(config, "real_time", "start")):
        raise UsageError(f"{flags}: only with the built-in simulator: give --simulator TRACK as well")
    if config.simulator is None and (flags := flags_given(config, "laps")):
        raise UsageError(f"{flags}: only with --simulator TRACK; other drives end with Ctrl-C")
    if config.simulator is not None and (flags := flags_given(config, "car")):
        raise UsageError(f"{flags}: the built-in simulator's car is known; leave it out")
    if config.simulator is not None and (flags := flags_given(config, "host", "port")):
        raise UsageError(f"{flags}: the built-in simulator runs on this machine and a free port; leave it out")
