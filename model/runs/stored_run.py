"""A run that is trained on this machine and kept in a store: download it to resume it, upload it while it
trains."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

from common import UserError
from common.errors import UsageError
from common.location import Location, Url
from common.progress import progress_bar
from common.store_record import read_record
from model.errors import RunError
from model.runs.run_files import CONFIG
from model.runs.runs_in_store import find_in_store, stored_run_folder
from model.runs.training_progress import Epoch, Step

_EVERY_S: Final = 60.0
"""Time between two copies: equal to the time between two checkpoints."""


def bring_run_to(runs: Path, name: str) -> Path:
    """Copy the run with the URL `name` to the folder `runs`, to resume it. Files that this machine has trained and
    not yet uploaded stay. Raises RunError if the run does not exist, or if another run in `runs` has its name;
    StoreError if the store fails."""
    stored = find_in_store(name, runs)
    assert stored is not None  # noqa: S101
    local = runs / stored.name
    if local.exists() and read_record(local).url != str(stored.url):
        raise RunError(f"{local}: exists, but is not a copy of {stored.url}; move it away, or give another --runs")
    with stored_run_folder(stored.url, local) as folder, progress_bar() as progress:
        folder.download(keeps_local=True, objects=stored.files.values(), progress=progress)
    return local


def place_of_copies(to: Location, run: Path, *, is_new: bool) -> Url:
    """The URL that a run is copied to. Raises UsageError if `to` is not in a store; RunError if the name of a new
    run exists in the store; StoreError if the store fails."""
    if not isinstance(to, Url):
        raise UsageError(f"--copy-to {to}: expected a folder in a store, such as s3://BUCKET/runs")
    from common.object_store import find_object  # an extra

    url = to / run.name
    if is_new and find_object(url / CONFIG) is not None:
        raise RunError(f"{url}: exists already; give another --name, or continue it: `bc-train --resume {url}`")
    return url


class RunCopy:
    """A listener that copies a run to a store once a minute, while the training continues."""

    def __init__(self, run: Path, url: Url) -> None:
        self._run = run
        self._url = url
        self._copied_s = time.monotonic()
        self._pool = ThreadPoolExecutor(1, "copy")
        self._copying: Future[None] | None = None

    def step(self, step: Step) -> None:
        self._copy_if_due()

    def epoch(self, epoch: Epoch) -> None:
        self._copy_if_due()

    def close(self) -> None: ...

    def finish(self) -> str:
        """Copy the remaining files. Returns the reason if that fails, else an empty string."""
        self._pool.shutdown()
        try:
            self._copy()
        except (UserError, OSError) as error:
            return f"{self._run}: not all of it is in {self._url} ({error})"
        return ""

    def _copy_if_due(self) -> None:
        is_idle = self._copying is None or self._copying.done()  # a failed copy is tried again
        if is_idle and time.monotonic() - self._copied_s > _EVERY_S:
            self._copied_s = time.monotonic()
            self._copying = self._pool.submit(self._copy)

    def _copy(self) -> None:
        if (self._run / CONFIG).is_file():  # a new run that has saved nothing is removed
            with stored_run_folder(self._url, self._run, waits=False) as folder:
                folder.upload()
