"""The verbs of `bc-eval` and their flags."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal, TypeAlias

import tyro

from common.command import flags_given
from common.ray_flag import RayAddress
from common.verbs import Earlier
from model.config import Device, Precision

_Run: TypeAlias = Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")]
_Tracks: TypeAlias = Annotated[tuple[str, ...], tyro.conf.arg(metavar="TRACK [TRACK ...]")]


@dataclass(frozen=True)
class FrameFlags:
    """The recorded frames."""

    RARE: ClassVar[str] = "split"
    index: Annotated[
        Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(default: the run's index)")
    ] = None
    """The index to measure on."""
    split: Literal["validation", "train"] = "validation"
    """Frames held out, or training's balanced ones."""
    session: Annotated[tuple[str, ...], tyro.conf.arg(metavar="SESSION [SESSION ...]")] = ()
    """Measure on these whole sessions, without an index."""
    sessions: Path = Path("sessions")
    """The logs, for --session and foreign indexes."""

    def __post_init__(self) -> None:
        if self.session and flags_given(self, "index", "split"):
            raise ValueError("--session measures whole sessions without an index: leave out --index and --split")


@dataclass(frozen=True)
class DriveFlags:
    """The drives."""

    RARE: ClassVar[str] = "device precision drives ray"
    laps: float = 1.0
    """Laps on each track."""
    speed: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MPH [MPH ...]")] = (10.0,)
    """Set speeds, each on every track."""
    device: Device = "auto"
    """auto: a GPU if there is one."""
    precision: Precision = "auto"
    """Arithmetic; auto: the fastest."""
    drives: Path = Path("drives")
    """Folder of the drives' logs."""
    force: bool = False
    """Replace existing logs."""
    ray: RayAddress = None
    """Drive on a Ray cluster with shared folders."""


@dataclass(frozen=True)
class Eval:
    """Measure a trained network on recorded frames. With a verb, let it drive in the simulator, or compare two.

    bc-eval first
    bc-eval first --session sunday
    bc-eval drive first --tracks lake mountain
    bc-eval compare first second

    `bc-eval drive --help` shows the flags of a verb.
    """

    RARE: ClassVar[str] = "network"
    run: _Run = None
    """Name or folder; by default the newest."""
    network: tuple[str, ...] = ()
    """Your network's code: FILE.py:CLASS or MODULE:CLASS."""
    frames: tyro.conf.OmitArgPrefixes[FrameFlags] = field(default_factory=FrameFlags)
    bins: bool = False
    """Also show the errors in each steering bin."""
    worst: Annotated[
        int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="(default: none; 10 with --json)")
    ] = None
    """Worst frames to list, at most one a second."""
    runs: Path = Path("runs")
    """The runs."""
    json: bool = False
    """Print a JSON object."""

    def __post_init__(self) -> None:
        if self.worst is not None and self.worst < 0:
            raise ValueError(f"--worst {self.worst:,}: expected a number of frames, 0 for none")


@dataclass(frozen=True)
class EvalDrive:
    """Let a trained network drive in the built-in simulator.

    bc-eval drive
    bc-eval drive first --tracks lake mountain random:1 --speed 10 20
    """

    RARE: ClassVar[str] = "network"
    run: _Run = None
    """Name or folder; by default the newest."""
    network: tuple[str, ...] = ()
    """Your network's code: FILE.py:CLASS or MODULE:CLASS."""
    tracks: _Tracks = ("lake",)
    """The tracks: lake, mountain, random:SEED, hairpins:SEED."""
    driving: tyro.conf.OmitArgPrefixes[DriveFlags] = field(default_factory=DriveFlags)
    runs: Path = Path("runs")
    """The runs."""
    json: bool = False
    """Print a JSON object for each drive."""


@dataclass(frozen=True)
class EvalCompare:
    """Compare run B with run A: on the same recorded frames, or with --tracks on the same roads.

    bc-eval compare first second
    bc-eval compare first second --session sunday --gate
    bc-eval compare first second --tracks lake mountain
    """

    RARE: ClassVar[str] = "network tolerance"
    a: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="A")]
    """The run to compare with, by name or folder."""
    b: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="B")]
    """The run that may be worse."""
    network: tuple[str, ...] = ()
    """Your networks' code: FILE.py:CLASS or MODULE:CLASS."""
    gate: bool = False
    """Exit code 1 if B is worse."""
    tolerance: Annotated[
        float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: 0; with --tracks 0.02)")
    ] = None
    """How much worse B may be, as a share."""
    frames: tyro.conf.OmitArgPrefixes[FrameFlags] = field(default_factory=FrameFlags)
    tracks: _Tracks = ()
    """Drive these tracks: lake, mountain, random:SEED, hairpins:SEED."""
    driving: tyro.conf.OmitArgPrefixes[DriveFlags] = field(default_factory=DriveFlags)
    runs: Path = Path("runs")
    """The runs."""
    json: bool = False
    """Print a JSON object."""

    def __post_init__(self) -> None:
        if self.tolerance is not None and not 0 <= self.tolerance < 1:
            raise ValueError(f"--tolerance {self.tolerance:g}: expected a share from 0 to less than 1")
        of_the_other = self.frames if self.tracks else self.driving
        if flags := flags_given(of_the_other, *(flag.name for flag in fields(of_the_other))):
            raise ValueError(f"{flags}: {'not with' if self.tracks else 'only with'} --tracks, which drives")


EARLIER: Final = (
    Earlier("--compare", "compare", moved=2),
    Earlier("--simulator", "drive", renamed={"drive": "--tracks", "compare": "--tracks"}),
)
