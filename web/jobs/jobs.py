"""Jobs: commands that pages start, each in a separate process that outlives bc-web.

A job is a folder in the cache with the command, its output and its exit code, so that a later bc-web finds it. A
job ends by itself or by Ctrl-C (`stop`).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import IO, Final
from urllib.parse import urlencode

import msgspec

import behavioural_cloning_toolkit
from common.errors import printable
from common.locks import is_being_written
from common.untrusted import json_as, real_path
from web.errors import WebError, or_404
from web.folders.file_versions import digest, version_of
from web.jobs.job_forms import FORMS
from web.jobs.job_runner import ABOUT, EXIT, LOCK, OUTPUT, READY

_ROOT: Final = Path(behavioural_cloning_toolkit.__file__).parent
_KEPT: Final = 50  # jobs that have ended
_MAX_BYTES: Final = 64 << 10  # of the output, which a page shows: the last ones
_RUNNER: Final = "import sys; sys.path.append(sys.argv[2]); from web.jobs.job_runner import main; main()"
_STOPPED: Final = 130
_POLL_S: Final = 0.3
_STATES: Final = {
    0: "done",
    1: "failed",
    2: "refused",
    3: "done, but something was skipped or lost",
    _STOPPED: "stopped",
}


class About(msgspec.Struct):
    words: list[str]  # of the command line, "bc-..." first
    began: str  # UTC, ISO 8601
    made: str  # the page of its output; "" for none
    form: str = ""  # that started it
    values: dict[str, str] = {}  # of the form
    first: list[str] = []  # a command that has to end well before


@dataclass(frozen=True)
class Job:
    key: str
    folder: Path
    about: About
    code: int | None
    """Its exit code; None while it runs, and if it was killed."""
    is_running: bool

    @property
    def command(self) -> str:
        commands = filter(None, (self.about.first, self.about.words))
        return printable(" && ".join(map(shlex.join, commands)))

    @property
    def title(self) -> str:
        """Its form, and its run or its first words."""
        about = self.about
        if self.is_export:
            return printable(f"Export {Path(about.words[-1]).name}")
        form = next((form.title for form in FORMS if form.name == about.form), "")
        words = [word for word in about.words[1:] if not word.startswith("-")]
        return printable(f"{form or about.words[0]} {self.run if form else ' '.join(words[:2])}".strip())

    @property
    def state(self) -> str:
        if self.is_running:
            return "running"
        if self.code is None:
            return "killed, or the computer was switched off"
        if self.code < 0:
            return f"ended by signal {-self.code}"
        return _STATES.get(self.code, f"exit code {self.code}")

    @property
    def is_good(self) -> bool:
        return self.is_running or self.code in (0, 3)

    @property
    def is_training(self) -> bool:
        """Whether it trains a run, which has a page as soon as it has begun."""
        return self.about.words[0] == "bc-train" and self.about.made.startswith("/runs/")

    @property
    def is_export(self) -> bool:
        return self.about.made.startswith("/exports/")

    @property
    def is_stopped(self) -> bool:
        return self.code == _STOPPED

    @property
    def run(self) -> str:
        """The name in its form; for a training, the run's."""
        return self.about.values.get("name") or self.about.values.get("run", "")

    @property
    def form_address(self) -> str:
        """The form that started it, with the same values; "" if no form did."""
        about = self.about
        return f"/jobs?{urlencode({'start': about.form, **about.values})}" if about.form else ""

    @property
    def seconds(self) -> float:
        began_s = datetime.fromisoformat(self.about.began).timestamp()
        try:
            end_s = (self.folder / EXIT).stat().st_mtime
        except OSError:
            end_s = datetime.now(UTC).timestamp() if self.is_running else began_s
        return max(0.0, end_s - began_s)

    def output(self) -> str:
        try:
            with (self.folder / OUTPUT).open("rb") as stream:
                size = stream.seek(0, os.SEEK_END)
                stream.seek(max(0, size - _MAX_BYTES))
                text = stream.read().decode(errors="replace")
        except OSError:
            return ""
        lines = (text if size <= _MAX_BYTES else "...\n" + text.partition("\n")[2]).split("\n")
        return "\n".join(printable(line.rpartition("\r")[2]) for line in lines)

    def last_line(self) -> str:
        return next((line for line in reversed(self.output().splitlines()) if line.strip()), "")


class Jobs:
    """The jobs of a project, which is the folder where bc-web was started."""

    def __init__(self, cache: Path) -> None:
        project = hashlib.sha256(os.fsencode(Path.cwd())).hexdigest()[:16]
        self.folder = cache / "jobs" / project
        self._lock = threading.Lock()

    def all(self) -> list[Job]:
        """All jobs, the newest first."""
        return sorted(self._read(), key=lambda job: job.key, reverse=True)

    def get(self, key: str) -> Job:
        job = next((job for job in self._read() if job.key == key), None)
        return or_404(job, f"no job {key!r}: only the newest {_KEPT} are kept, in the cache folder")

    def version(self) -> str:
        """A text that changes when a job starts, prints or ends, and every five seconds of a running job."""
        states = ((job, version_of(job.folder / OUTPUT, job.folder / EXIT)) for job in self.all())
        # pages show how long a job has run
        return digest(
            f"{job.key} {version} {job.is_running and 5 * (job.seconds // 5)}" for job, version in states
        )

    def training(self, page: str) -> Job | None:
        """The running training of the run with that page."""
        return next((job for job in self.trainings(page) if job.is_running), None)

    def trainings(self, page: str) -> list[Job]:
        """The trainings of the run with that page, the newest first."""
        return [job for job in self.all() if job.is_training and job.about.made == page]

    def start(
        self,
        words: Sequence[str],
        made: str,
        form: str = "",
        values: Mapping[str, str] = MappingProxyType({}),
        *,
        records: bool = False,
        first: Sequence[str] = (),
    ) -> Job:
        """Start a command, after the command `first`. `words` are its command line, which a form made of `values`.
        Raises WebError if it `records` a log that a running job records, too: only one of the logs could get the
        name."""
        now = datetime.now(UTC)
        key = f"{now:%Y%m%d-%H%M%S-%f}-{secrets.token_hex(2)}"
        folder = self.folder / key
        with self._lock:
            if records and any(job.is_running and job.about.made == made for job in self.all()):
                raise WebError("a job that records a log of this name is running: give another name", 409)
            for ended in [job for job in self.all() if not job.is_running][_KEPT:]:
                shutil.rmtree(ended.folder, ignore_errors=True)
            folder.mkdir(parents=True)
            about = About(list(words), now.isoformat(), made, form, dict(values), list(first))
            (folder / ABOUT).write_bytes(msgspec.json.encode(about))
            line = [sys.executable, "-P", "-c", _RUNNER, str(real_path(folder)), str(_ROOT)]
            # a new session: neither the terminal's Ctrl-C nor its end reaches the job
            process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # of Windows
            )
            (folder / "pid").write_text(str(process.pid), encoding="utf-8")
            is_ready = process.stdout is not None and _is_ready(process.stdout)  # it counts as running
        threading.Thread(target=process.wait, name="a job", daemon=True).start()  # leaves no zombie
        if not is_ready:
            raise WebError(f"{shlex.join(words)}: it did not start; the cache folder may be full", 500)
        return self.get(key)

    def start_in_turn(self, starts: Sequence[Callable[[], Job]]) -> None:
        """Start jobs one after the other, each when the one before has ended, as long as bc-web runs."""

        def run() -> None:
            for start in starts:
                with contextlib.suppress(WebError):  # its name was taken meanwhile
                    key = start().key
                    while self.get(key).is_running:
                        time.sleep(_POLL_S)

        threading.Thread(target=run, name="jobs in turn", daemon=True).start()

    def stop(self, key: str) -> None:
        """Press Ctrl-C in a job, if it runs. The second time, it ends at once."""
        job = self.get(key)
        if not job.is_running:
            return
        with contextlib.suppress(OSError, ValueError):  # it has just ended
            number = int((job.folder / "pid").read_text(encoding="utf-8"))
            if sys.platform == "win32":
                os.kill(number, signal.CTRL_BREAK_EVENT)
            else:
                os.killpg(number, signal.SIGINT)

    def _read(self) -> Iterator[Job]:
        for folder in self.folder.glob("*"):
            with contextlib.suppress(OSError):  # deleted meanwhile
                if about := json_as((folder / ABOUT).read_bytes(), About):
                    yield _job(folder, about)


def _is_ready(stream: IO[bytes]) -> bool:
    with stream:
        return stream.readline() == READY


def _job(folder: Path, about: About) -> Job:
    is_running = is_being_written(folder / LOCK)  # before the exit code, which is written first
    code = None
    with contextlib.suppress(OSError, ValueError):
        code = int((folder / EXIT).read_text(encoding="utf-8"))
    return Job(folder.name, folder, about, code, is_running and code is None)
