"""The verbs of `bc-train`: their flags, and the defaults that follow from a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, TypeAlias

import tyro

from common.errors import UsageError
from common.location import local_path
from common.ray_flag import RayAddress
from common.recipe import recipe_given, value_given
from common.verbs import Earlier, word_after_verb
from model.config import TrainConfig
from model.runs.run_files import RUNS

INDEX: Final = Path("index")
VERBS: Final = ("resume", "continue", "export", "drive", "compare")  # of bc-train and bc-eval
SESSIONS: Final = Path("sessions")

_Name: TypeAlias = Annotated[str, tyro.conf.arg(metavar="NAME")]
_Run: TypeAlias = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
_Sessions: TypeAlias = Annotated[tuple[str, ...], tyro.conf.arg(metavar="SESSION [SESSION ...]")]
_NOT_GIVEN: Final = tyro.conf.arg(metavar="PATH", help_behavior_hint="(default: index, or that of the run)")
_NO_FOLDER: Final = tyro.conf.arg(metavar="PATH", help_behavior_hint="(default: sessions, or those of the run)")
_COPY_TO: Final = "`bc-copy runs/NAME s3://BUCKET/runs/NAME --follow` copies the run while it is trained"


@dataclass(frozen=True)
class Places:
    """Folders."""

    RARE: ClassVar[str] = "sessions"
    index: Annotated[Path | None, _NOT_GIVEN] = None
    """The index."""
    sessions: Annotated[Path | None, _NO_FOLDER] = None
    """The logs, if the index must be built."""
    runs: Path = RUNS
    """Folder of the runs."""

    def index_of(self, run: Path) -> Path:
        """The index that is given, or that of the run. Raises RunError if the run's is in a store."""
        from model.runs.provenance import local_index_of

        return self.index or local_index_of(run) or INDEX


@dataclass(frozen=True)
class ProgressFlags:
    """Who else receives the progress."""

    RARE: ClassVar[str] = "tensorboard listener"
    tensorboard: bool = False
    """Also write the curves for TensorBoard."""
    listener: str | None = None
    """Your code that receives the progress: FILE.py:CLASS or MODULE:CLASS."""


@dataclass(frozen=True)
class Train:
    """Train the network on the index and keep the run in runs/NAME/. A missing index is built from all sessions.
    Ctrl-C stops after the current batch.

    bc-train resume first
    bc-train continue first --takeovers drives/run.mcap
    bc-train export first --onnx

    `bc-train resume --help` shows the flags of a verb.
    """

    RARE: ClassVar[str] = "ray"
    REMOVED: ClassVar[Mapping[str, str]] = {
        "--copy-to": _COPY_TO,
        "--takeovers": "`bc-train continue RUN --takeovers LOG` adds a drive's takeovers to a run's samples",
    }
    name: _Name = ""
    """Name of the run; by default date, time and six random digits."""
    on: _Sessions = ()
    """Train only on these sessions; builds index-NAME."""
    like: Annotated[str | None, tyro.conf.arg(metavar="RUN")] = None
    """Use this run's samples, and its settings except for flags that you give."""
    places: tyro.conf.OmitArgPrefixes[Places] = field(default_factory=Places)
    progress: tyro.conf.OmitArgPrefixes[ProgressFlags] = field(default_factory=ProgressFlags)
    ray: RayAddress = None
    """Train on a node of a Ray cluster with shared folders."""
    config: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


@dataclass(frozen=True)
class Resume:
    """Resume a run that was stopped, or make it longer: the weights are those of an uninterrupted training.

    bc-train resume first
    bc-train resume first --epochs 20
    """

    RARE: ClassVar[str] = "ray"
    REMOVED: ClassVar[Mapping[str, str]] = {"--copy-to": _COPY_TO}
    run: _Run
    """The run, by name or folder."""
    places: tyro.conf.OmitArgPrefixes[Places] = field(default_factory=Places)
    progress: tyro.conf.OmitArgPrefixes[ProgressFlags] = field(default_factory=ProgressFlags)
    ray: RayAddress = None
    """Train on a node of a Ray cluster with shared folders."""
    config: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


@dataclass(frozen=True)
class Continue:
    """Train a new run of the same network, which starts from the weights of an earlier run.

    bc-train continue first --on sunday
    bc-train continue first --takeovers drives/run.mcap
    """

    RARE: ClassVar[str] = "drives ray"
    REMOVED: ClassVar[Mapping[str, str]] = {
        "--copy-to": _COPY_TO,
        "--like": "the network is that of RUN; give other settings as flags",
    }
    run: _Run
    """The earlier run, by name or folder."""
    name: _Name = ""
    """Name of the new run; by default date, time and six random digits."""
    on: _Sessions = ()
    """Train only on these sessions; builds index-NAME."""
    takeovers: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="LOG [LOG ...]")] = ()
    """Add these drives' takeovers to the earlier run's samples; builds index-NAME."""
    drives: Path = Path("drives")
    """The drives that the earlier run learnt from."""
    places: tyro.conf.OmitArgPrefixes[Places] = field(default_factory=Places)
    progress: tyro.conf.OmitArgPrefixes[ProgressFlags] = field(default_factory=ProgressFlags)
    ray: RayAddress = None
    """Train on a node of a Ray cluster with shared folders."""
    config: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


EARLIER: Final = (
    Earlier("--resume", "resume", moved=1),
    Earlier("--init", "continue", moved=1),
)


def defaults_of_new() -> Train:
    """With --like, the settings of that run. Raises UsageError for another --recipe: it would change nothing."""
    like = value_given("--like")
    if not like:
        return Train(config=TrainConfig.of(recipe_given()))
    settings = _settings_of(like)
    if recipe_given(settings.recipe) != settings.recipe:
        raise UsageError("--recipe with --like: that run's settings are repeated; leave out one of them")
    return Train(config=settings)


def defaults_of_resumed() -> Resume | None:
    """The settings of the run that is resumed."""
    name = word_after_verb("RUN")
    return None if name is None else Resume(name, config=_settings_of(name))


def defaults_of_continued() -> Continue | None:
    """The settings of the recipe, for the network of the earlier run."""
    name = word_after_verb("RUN")
    if name is None:
        return None
    from model.runs.network_of_run import network_settings
    from model.runs.run_folder import find_run, load_config

    run = find_run(name, _runs())
    stored = load_config(run)
    _refuse_unnamed_code(stored, run)
    return Continue(name, config=replace(TrainConfig.of(recipe_given()), **network_settings(stored, run)))


def _settings_of(name: str) -> TrainConfig:
    from model.runs.provenance import training_of
    from model.runs.run_folder import find_any_run, load_config

    run = find_any_run(name, _runs())
    stored = load_config(run)
    _refuse_unnamed_code(stored, run)
    return training_of(stored, run)


def _runs() -> Path:
    return local_path(value_given("--runs") or RUNS)


def _refuse_unnamed_code(stored: dict[str, Any], run: Path) -> None:
    """Raise RunError if a run's code would run although the user did not name it."""
    from model.runs.network_of_run import choice_of, is_own_network

    if is_own_network(stored) and value_given("--network") is None:
        choice_of(stored, run)
