"""The entries of the list of runs: each run's summary, as in `bc-runs`, its verdict, and whether it is trained."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from common import UserError
from common.errors import printable
from model.runs.run_files import CONFIG, RESULTS_FILE, WEIGHTS, is_being_trained
from model.runs.training_progress import METRICS_FILE, STEPS_FILE
from model.runs.worst_pictures import WORST_FILE
from web.folders.cache_folder import Background
from web.folders.file_versions import digest, version_of
from web.folders.notes import NOTE_FILE, Note, read_note
from web.folders.project_folders import ProjectFolders, key_of

if TYPE_CHECKING:  # these load PyTorch, which only pages of runs need
    from model.runs.history import History
    from model.runs.run_summary import RunSummary


class Badge(NamedTuple):
    word: Literal["drives", "perhaps", "not yet"]
    sentence: str
    kind: Literal["good", "", "bad"]  # of its colour


def badge_of(run: RunSummary | None) -> Badge | None:
    """None for a run that is not read yet, or that was not measured."""
    if run is None or (verdict := run.verdict) is None:
        return None
    band = verdict.drivable.band
    like = (
        f"{band.stayed} of {band.networks} networks as good as this one stayed on the built-in roads"
        if band
        else ""
    )
    match verdict.in_short:
        case "drives":
            return Badge("drives", f"It {printable(verdict.driven)}.", "good")
        case "leaves the road":
            return Badge("not yet", f"It {printable(verdict.driven)}.", "bad")
        case "enough":
            return Badge("drives", f"It should stay on the road: {like}.", "good")
        case "perhaps":
            return Badge("perhaps", f"Perhaps it stays on the road{f': {like}' * bool(like)}. Let it try.", "")
        case "too weak":
            return Badge("not yet", f"It needs to learn more: {like}.", "bad")
        case "no better":
            return Badge(
                "not yet", "It needs to learn more: it is no better than steering always the same.", "bad"
            )
    return None


_SUMMED_UP: Final = CONFIG, METRICS_FILE, RESULTS_FILE, WEIGHTS
_GROWING: Final = STEPS_FILE, WORST_FILE
_SHOWN: Final = *_SUMMED_UP, *_GROWING, NOTE_FILE
_HISTORY: Final = METRICS_FILE, *_GROWING


@dataclass(frozen=True)
class RunCard:
    """A run in the list. `summary` is None until it is read, and if it is unreadable (`problem`)."""

    key: str
    path: Path
    summary: RunSummary | None
    problem: str
    is_training: bool

    @property
    def name(self) -> str:
        return printable(self.path.name)

    @cached_property
    def note(self) -> Note:
        return read_note(self.path)

    @property
    def state(self) -> str:
        """The state in one word: "" for a run that is whole."""
        if self.problem:
            return "damaged"
        if self.is_training:
            return "training"
        return "reading" if self.summary is None else "" if self.summary.kept_epoch else "no epoch yet"


class RunCards:
    def __init__(self, folders: ProjectFolders) -> None:
        self._folders = folders
        self._pool = ThreadPoolExecutor(1, "reading runs")
        self._summaries = Background(self._pool, _summary)

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)

    @property
    def done(self) -> int:
        return self._summaries.done

    def version(self) -> str:
        """A text that changes with every file that a training or an evaluation writes."""
        runs = self._folders.run_folders().values()
        versions = [_version_of(path, *_SHOWN) for path in runs]
        return digest([*versions, *(str(is_being_trained(path)) for path in runs)])

    def cards(self) -> list[RunCard]:
        """The cards of all runs, by name. Those not read within a moment have no `summary` yet."""
        paths = self._folders.run_folders().values()
        versions = [(path, _version_of(path, *_SUMMED_UP)) for path in paths]
        summaries = self._summaries.results(versions)
        return [_card(path, summaries.get(path)) for path in paths]

    def history(self, path: Path) -> History:
        """The course of a training so far. Raises RunError if it cannot be read."""
        return _history(path, _version_of(path, *_HISTORY))


def _version_of(run: Path, *names: str) -> str:
    return version_of(*(run / name for name in names))


def _card(path: Path, summary: RunSummary | UserError | None) -> RunCard:
    problem = ""
    if isinstance(summary, UserError):
        problem, summary = str(summary), None
    elif summary is not None and summary.problem:
        problem, summary = summary.problem, None
    return RunCard(key_of(path), path, summary, printable(problem), is_being_trained(path))


@lru_cache(maxsize=8)
def _history(run: Path, version: str) -> History:
    from model.runs.history import read_history

    return read_history(run)[0]


def _summary(run: Path, version: str) -> RunSummary:
    from model.runs.run_summary import summarize_run

    return summarize_run(run)
