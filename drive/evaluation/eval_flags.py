"""The flags of `bc-eval`, and the combinations that are refused."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

import tyro

from common.command import flags_given
from common.errors import UsageError
from common.ray_flag import RayAddress


def _default(metavar: str, value: str) -> Any:
    """A flag that is None unless given, because it belongs to only one way of measuring."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {value})")


@dataclass(frozen=True)
class Eval:
    """Measure a trained network: on held-out frames, or in the simulator.

    bc-eval first
    bc-eval first --session sunday
    bc-eval first --simulator lake mountain
    bc-eval --compare first second
    """

    RARE: ClassVar[str] = "network tolerance split device precision drives ray"
    run: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """Name or folder; by default the newest."""
    network: tuple[str, ...] = ()
    """Your network's code: FILE.py:CLASS or MODULE:CLASS."""
    compare: Annotated[tuple[str, str] | None, tyro.conf.arg(metavar="A B")] = None
    """Compare B with A on the same frames or tracks."""
    gate: bool = False
    """With --compare: exit code 1 if B is worse."""
    tolerance: Annotated[float | None, _default("SHARE", "0, and 0.02 with --simulator")] = None
    """How much worse B may be, as a share."""
    index: Annotated[Path | None, _default("PATH", "the run's index")] = None
    """The index to measure on."""
    split: Annotated[Literal["validation", "train"] | None, _default("{validation,train}", "validation")] = None
    """Frames held out, or training's balanced ones."""
    session: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="SESSION [SESSION ...]")] = None
    """Measure on these whole sessions, without an index."""
    sessions: Annotated[Path | None, _default("PATH", "sessions")] = None
    """The logs, for --session and foreign indexes."""
    bins: bool = False
    """Also show the errors in each steering bin."""
    worst: Annotated[int | None, _default("INT", "none; 10 with --json")] = None
    """Worst frames to list, at most one a second."""
    simulator: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="TRACK [TRACK ...]")] = None
    """Drive these tracks: lake, mountain, random:SEED, hairpins:SEED."""
    laps: Annotated[float | None, _default("FLOAT", "1")] = None
    """Laps on each track."""
    speed: Annotated[tuple[float, ...] | None, _default("MPH [MPH ...]", "10")] = None
    """Set speeds, each on every track."""
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, _default("{auto,cpu,cuda}", "auto")] = None
    """auto: a GPU if there is one."""
    precision: Annotated[
        Literal["auto", "float32", "bfloat16"] | None, _default("{auto,float32,bfloat16}", "auto")
    ] = None
    """Arithmetic; auto: the fastest."""
    drives: Annotated[Path | None, _default("PATH", "drives")] = None
    """Folder of the drives' logs."""
    force: bool = False
    """Replace existing logs."""
    ray: RayAddress = None
    """Drive on a Ray cluster with shared folders."""
    runs: Path = Path("runs")
    """The runs."""
    json: bool = False
    """Print JSON: one object, or one a drive."""


OF_FRAMES: Final = ("index", "split", "session", "sessions", "bins", "worst")
OF_DRIVES: Final = ("laps", "speed", "device", "precision", "drives", "force", "ray")


def refuse_contradictions(config: Eval) -> None:
    """Raise UsageError for flags that contradict each other, and for invalid values."""
    if config.simulator is None and (flags := flags_given(config, *OF_DRIVES)):
        raise UsageError(f"{flags}: only with --simulator TRACK: without it, recorded frames are measured")
    if config.simulator is not None and (flags := flags_given(config, *OF_FRAMES)):
        raise UsageError(f"{flags}: only for recorded frames, but --simulator drives: give one or the other")
    if config.simulator == () or config.speed == ():
        raise UsageError("nothing to drive: give --simulator at least one track, and --speed at least one speed")
    for flag, values in (("--simulator", config.simulator), ("--speed", config.speed)):
        if values is not None and len(set(values)) < len(values):
            raise UsageError(f"{flag} {' '.join(map(str, values))}: give each once")
    if config.session == ():
        raise UsageError("nothing to measure: give --session at least one session")
    if config.session is not None and (config.index is not None or config.split is not None):
        raise UsageError("--session measures whole sessions without an index: leave out --index and --split")
    if config.compare is None:
        if config.tolerance is not None:
            raise UsageError("--tolerance is for --compare A B: give that, too")
        if config.gate:
            raise UsageError("--gate is for --compare A B: give that, too")
    elif config.run is not None:
        raise UsageError(f"{config.run}: --compare names its two runs itself: leave it out")
    elif flags := flags_given(config, "bins", "worst"):
        raise UsageError(f"{flags}: only for one run, but --compare takes two: give one or the other")
    if config.tolerance is not None and not 0 <= config.tolerance < 1:
        raise UsageError(f"--tolerance {config.tolerance:g}: expected a share from 0 to less than 1")
    if config.worst is not None and config.worst < 0:
        raise UsageError(f"--worst {config.worst:,}: expected a number of frames, 0 for none")
