"""A project at a glance: the contents of its folders, odd rows, the verdict on the newest run, and the next
commands.

It reads no pictures: only the ends of logs, the metadata of the index, and the text files of the newest run.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from common.errors import UserError, as_user_error, counted, first_of, printable
from common.locks import is_being_written
from model.runs.advice import Advice
from recorder.log.tags import FINE, tags_path
from recorder.log_flag import logs_in
from recorder.rows.odd_stretches import title_of
from recorder.upkeep.log_info import LogInfo, describe

MAX_COMMANDS: Final = 3
_MAX_NAMED: Final = 5
_MUCH: Final = 0.05  # share of odd rows in a log that is worth a look
_S_PER_MIN: Final = 60.0


@dataclass(frozen=True)
class Diagnosis:
    here: list[str] = field(default_factory=list)  # a line for each folder
    odd: list[str] = field(default_factory=list)
    good: list[str] = field(default_factory=list)  # the verdict on the newest run
    advice: list[Advice] = field(default_factory=list)  # the next commands, the most important first
    problems: list[str] = field(default_factory=list)  # files that could not be read


def examine() -> Diagnosis:
    """Examine the folders sessions, index, runs and drives of the project in the working folder. A file that
    cannot be read becomes a problem; the others are still examined."""
    diagnosis, wanted = Diagnosis(), _Commands()
    sessions = _logs("sessions", diagnosis, wanted)
    _index(diagnosis, wanted, has_sessions=bool(sessions))
    _runs(diagnosis, wanted, has_sessions=bool(sessions))
    drives = _logs("drives", diagnosis, wanted)
    if not sessions and not drives:
        wanted.begin.append(Advice("see the whole chain at work", "bc-demo"))
        wanted.begin.append(Advice("the built-in simulator's expert drives", "bc-record lake --track lake"))
        wanted.begin.append(Advice("import a drive from elsewhere", "bc-import ~/recording mine"))
    if drives:
        newest = max(drives, key=lambda info: info.start)
        wanted.last.append(Advice("the newest drive", f"bc-play {shlex.quote(newest.path)}"))
    diagnosis.advice.extend(wanted.first(MAX_COMMANDS))
    return diagnosis


@dataclass(frozen=True)
class _Commands:
    mend: list[Advice] = field(default_factory=list)
    begin: list[Advice] = field(default_factory=list)
    learn: list[Advice] = field(default_factory=list)
    look: list[Advice] = field(default_factory=list)
    last: list[Advice] = field(default_factory=list)

    def first(self, count: int) -> list[Advice]:
        always = [
            Advice("pages of the whole project", "bc-web --open"),
            Advice("what each log holds", "bc-log ls"),
        ]
        ordered = [*self.mend, *self.begin, *self.learn, *self.look, *self.last, *always]
        return list({advice.command: advice for advice in reversed(ordered)}.values())[::-1][:count]


def _logs(name: str, diagnosis: Diagnosis, wanted: _Commands) -> list[LogInfo]:
    logs = [path for path in logs_in(Path(name)) if not is_being_written(path)]
    infos: list[LogInfo] = []
    broken: list[Path] = []
    for path in logs:
        info = _tried(partial(describe, path), path, diagnosis)
        if info is not None:
            infos.append(info)
        if info is None or info.notice:
            broken.append(path)
            diagnosis.odd.append(
                f"{shlex.quote(str(path))}: {'cannot be read' if info is None else 'never finished'}"
            )
    if broken:
        others = f", and {counted(len(broken) - 1, 'other log')} of {name}" if len(broken) > 1 else ""
        first = shlex.quote(str(broken[0]))
        wanted.mend.append(Advice(f"it is damaged, or not finished{others}", f"bc-log recover {first}"))
    if not logs:
        diagnosis.here.append(f"{name}: no logs")
        return []
    minutes = sum(info.length_s for info in infos) / _S_PER_MIN
    rows = counted(sum(info.rows for info in infos), "row")
    diagnosis.here.append(f"{name}: {counted(len(logs), 'log')}, {rows}, {minutes:,.1f} min")
    _odd_rows(name, infos, diagnosis, wanted)
    return infos


def _odd_rows(name: str, logs: Iterable[LogInfo], diagnosis: Diagnosis, wanted: _Commands) -> None:
    """Add the logs with the most odd rows to the diagnosis, without logs that a person has tagged."""
    odd = sorted(
        (info for info in logs if info.odd and all(tag.name == FINE for tag in info.tags)),
        key=lambda info: -sum(info.odd_rows.values()),
    )
    for info in odd[:_MAX_NAMED]:
        path = shlex.quote(info.path)
        stretches, rows = info.odd or [], sum(info.odd_rows.values())
        kinds = ", ".join(f"{title_of(kind)}: {count:,}" for kind, count in info.odd_rows.items())
        longest = max(stretches, key=lambda stretch: stretch.last_row - stretch.first_row)
        at = f"the longest stretch: rows {longest.first_row} to {longest.last_row}"
        diagnosis.odd.append(printable(f"{path}: {counted(rows, 'odd row')} of {info.rows:,} ({kinds}); {at}"))
        # `bc-index` leaves out the other stretches
        learnt = sum(stretch.rows for stretch in stretches if stretch.is_learnt)
        if name == "sessions" and learnt > _MUCH * info.rows:
            wanted.look.append(Advice(f"{counted(learnt, 'odd row')} of {info.rows:,}", f"bc-log check {path}"))
    if len(odd) > _MAX_NAMED:
        diagnosis.odd.append(f"and {counted(len(odd) - _MAX_NAMED, 'more log')} in {name}: `bc-log ls {name}`")


def _index(diagnosis: Diagnosis, wanted: _Commands, *, has_sessions: bool) -> None:
    from dataset import sessions_not_indexed
    from dataset.parquet_file import read_metadata
    from dataset.samples.samples_format import EARLIER_RULES, SAMPLES_NAME, has_earlier_rules

    index, sessions = Path("index"), Path("sessions")
    if not (index / SAMPLES_NAME).exists():
        own = sorted(Path().glob(f"index-*/{SAMPLES_NAME}"))  # of `bc-train --on`
        diagnosis.here.append(
            f"index: {counted(len(own), 'run has its own', 'runs have their own') if own else 'none'}"
        )
        if has_sessions and not own:
            wanted.learn.append(Advice("no index yet", "bc-index"))
        return
    stored = read_metadata(index / SAMPLES_NAME) or {}
    counts = stored.get("counts")
    if counts is None:
        diagnosis.problems.append(
            f"{index / SAMPLES_NAME}: damaged, or of another version; `bc-index` rebuilds it"
        )
        wanted.mend.append(Advice("the index cannot be read", "bc-index"))
        return
    training, held_out = (sum(count[name] for count in counts.values()) for name in ("training", "validation"))
    sizes = f"{counted(training, 'frame')} for training, {held_out:,} held out"
    diagnosis.here.append(f"index: {counted(len(counts), 'session')}, {sizes}")
    if has_earlier_rules(stored):
        diagnosis.odd.append(f"index: {EARLIER_RULES}")
        wanted.learn.append(Advice("it leaves the odd rows out of training and validation", "bc-index"))
    tags = map(tags_path, logs_in(sessions)) if has_sessions else ()
    if any(_time_ns(path) > _time_ns(index / SAMPLES_NAME) for path in tags):
        wanted.learn.append(Advice("tags are newer than the index", "bc-index"))
    absent = _tried(lambda: sessions_not_indexed(index, sessions), index, diagnosis) if has_sessions else []
    if absent:
        diagnosis.odd.append(f"index: does not hold {first_of(list(map(printable, absent)))}")
        wanted.learn.append(Advice(f"{counted(len(absent), 'session')} not in the index", "bc-index"))


def _runs(diagnosis: Diagnosis, wanted: _Commands, *, has_sessions: bool) -> None:
    from dataset.samples.samples_format import SAMPLES_NAME
    from model.runs.run_files import CONFIG, WEIGHTS
    from model.runs.run_summary import judge

    runs = [path.parent for path in Path("runs").glob(f"*/{CONFIG}")]
    samples = Path("index", SAMPLES_NAME)
    if not runs:
        diagnosis.here.append("runs: none")
        if has_sessions:
            wanted.learn.append(Advice("no run yet", "bc-train"))
            wanted.last.append(Advice("how good the run is", "bc-eval"))
        return
    newest = max(runs, key=lambda run: max(_time_ns(run / WEIGHTS), _time_ns(run / CONFIG)))
    name = printable(newest.name)
    diagnosis.here.append(f"runs: {len(runs):,}, the newest is {name}")
    if _time_ns(samples) > max(_time_ns(newest / WEIGHTS), _time_ns(newest / CONFIG)):
        wanted.learn.append(Advice(f"the index is newer than {name}", "bc-train"))
    if (verdict := _tried(lambda: judge(newest), newest, diagnosis)) is not None:
        diagnosis.good.append(f"{name}: {verdict.summary}")
        wanted.learn.append(verdict.advice)


_Result = TypeVar("_Result")


def _tried(read: Callable[[], _Result], place: Path, diagnosis: Diagnosis) -> _Result | None:
    try:
        return read()
    except Exception as error:
        problem: UserError = as_user_error(place, error)
        diagnosis.problems.append(str(problem))
        return None


def _time_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0
