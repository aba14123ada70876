"""Commands that make logs out of logs, wherever these and those lie: what is in a store is here while they run."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from common.command import FAILED
from common.errors import UsageError
from common.files import refuse_existing
from common.location import Location, Url, local_path
from common.output import print_message, print_next, shown_as
from common.progress import progress_bar
from recorder.errors import LogError
from recorder.log_copy_cli import copy_logs, refuse_taken_name, size_of


class MakesLogs(ABC):
    """A command that writes new logs, and leaves those alone that they are made of."""

    force: bool

    def run(self) -> int:
        code, to = make_logs(self), self.target()
        is_made = isinstance(to, Url) or to.exists()
        if code != FAILED and is_made:
            print_next(f"bc-log {'check' if to.suffix == '.mcap' else 'ls'} {shlex.quote(str(to))}")
        return code

    @abstractmethod
    def originals(self) -> Sequence[Location]:
        """The logs that are read."""

    @abstractmethod
    def target(self) -> Location:
        """The new log, or the folder of new logs. Raises UserError."""

    @abstractmethod
    def make(self, logs: Sequence[Path], to: Path) -> int:
        """Write the new logs; the exit code."""


class MakesLogsOfOne(MakesLogs):
    """One that reads a single log."""

    log: Location

    def originals(self) -> Sequence[Location]:
        return (self.log,)

    def make(self, logs: Sequence[Path], to: Path) -> int:
        (path,) = logs
        return self.make_of(path, to)

    @abstractmethod
    def make_of(self, path: Path, to: Path) -> int:
        """`make`, of that log."""


def make_logs(command: MakesLogs) -> int:
    """Run a command on files of this machine: copies of what is in a store, as long as it runs. What it makes for
    a store is made here, and copied there when it is whole."""
    originals, to = command.originals(), command.target()
    if isinstance(to, Path):
        if to.suffix == ".mcap" and any(isinstance(place, Url) for place in originals):
            refuse_existing(to, command.force)  # before gigabytes are brought
        with brought_as_they_are(originals) as logs:
            return command.make(logs, to)
    if to.suffix == ".mcap":
        refuse_taken_name(to, command.force)
        if to in originals:
            raise LogError(f"{to}: is the log itself, which is not changed; give another name")
    folder = Path(tempfile.mkdtemp(prefix="bc-new-logs-"))
    stays = False
    try:
        with brought_as_they_are(originals) as logs, shown_as({f"{folder}/": ""}):
            code = command.make(logs, folder / to.name if to.suffix == ".mcap" else folder)
        if made := sorted(folder.glob("*.mcap")):
            stays = True
            code = max(code, _copied(made, to, command.force))
            stays = code == FAILED
        return code
    finally:
        if stays:
            print_message(f"what was made is in {folder}: `bc-log copy {folder} {to}` copies it")
        else:
            shutil.rmtree(folder, ignore_errors=True)


def _copied(made: Sequence[Path], to: Url, overwrite: bool) -> int:
    if to.suffix != ".mcap":  # all of them, or none
        for log in made:
            refuse_taken_name(to / log.name, overwrite)
    return copy_logs(made, to, overwrite=overwrite)


@contextlib.contextmanager
def brought_as_they_are(places: Sequence[Location]) -> Iterator[list[Path]]:
    """The same logs as files of this machine; messages name them as in the store. Unfinished or damaged ones are
    brought as they are: their reader reports that."""
    if not any(isinstance(place, Url) for place in places):
        yield [local_path(place) for place in places]
        return
    from recorder.upkeep.copy_log import bring_log  # obstore, an extra

    with tempfile.TemporaryDirectory(prefix="bc-logs-") as folder:
        here: list[Path] = []
        names: dict[str, str] = {}
        for number, place in enumerate(places):
            if isinstance(place, Path):
                here.append(place)
                continue
            if not place.name:
                raise UsageError(f"{place}: a log was expected, such as {place}sessions/lake.mcap")
            copy = Path(folder) / str(number) / place.name
            copy.parent.mkdir()
            with progress_bar() as progress:
                task = progress.add_task(f"copying {place.name}, bytes", total=size_of(place), note="")
                bring_log(place, copy, partial(progress.advance, task))
            here.append(copy)
            names[str(copy.parent)] = str(place.parent).rstrip("/")
        with shown_as(names):
            yield here
