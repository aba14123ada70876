"""An index in a store: fetched, built on this machine, and then sent, whole or not at all.

Readers use samples.parquet. It is sent first, on the condition that it is still the one that was fetched: of two
machines that index at once one wins, and the other gets an error. The rest saves work to the next build, on any
machine; until it is sent, that build reads some logs once more.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from common.allowed_places import folders_of, remember_places
from common.errors import ObjectChangedError, UsageError
from common.location import Location, Url
from dataset.errors import DatasetError
from dataset.frames.frames_file import index_project
from dataset.index.build_state import FRAMES_FOLDER, STATE_NAME
from dataset.samples.samples_format import SAMPLES_NAME

if TYPE_CHECKING:
    from common.stored_folder import StoredFolder


@contextlib.contextmanager
def index_here(index: Location, logs: Sequence[Location]) -> Iterator[tuple[Path, Callable[[], object]]]:
    """The folder to build an index in, and what puts the finished one where it belongs: nothing, if that is here.

    Raises UsageError for logs of this machine in an index in a store, and for logs in the index's own folder;
    DatasetError where another machine has written the index meanwhile, StoreError.
    """
    if isinstance(index, Path):
        yield index, lambda: None
        return
    if local := next((log for log in logs if isinstance(log, Path)), None):
        raise UsageError(
            f"--index {index}: {local} is on this machine, where no other one would find it; `bc-log copy` it to"
            f" the store, and give --sessions {index.parent / 'sessions'}"
        )
    if within := next((log for log in logs if isinstance(log, Url) and log.is_in(index)), None):
        raise UsageError(
            f"--index {index}: {within} is in it, and all of an index is copied here and there; give a folder of"
            f" its own, such as --index {index / 'index'}"
        )
    from common.stored_folder import StoredFolder  # an extra

    with StoredFolder(index) as folder:
        folder.bring()
        folder.forget(SAMPLES_NAME, STATE_NAME)  # of a build that could not be put there
        yield folder.here, lambda: _put(folder, index, logs)


def frames_here(index: Location) -> Path:
    """The folder of an index's frames files; of an index in a store, a copy of it in the user's cache. Raises
    StoreError."""
    if isinstance(index, Path):
        return index / FRAMES_FOLDER
    from common.object_store import list_below  # an extra
    from common.stored_folder import StoredFolder

    objects = list_below(index)
    names = [entry.url.name_in(index) for entry in objects]
    with StoredFolder(index, waits=True) as folder:
        folder.bring(objects=objects, wanted=[name for name in names if name.startswith(f"{FRAMES_FOLDER}/")])
        return folder.here / FRAMES_FOLDER


def _put(folder: StoredFolder, index: Url, logs: Sequence[Location]) -> None:
    try:
        folder.send(first=[SAMPLES_NAME, f"{FRAMES_FOLDER}/"])
    except ObjectChangedError as error:
        raise DatasetError(f"{error}; give the command again: it continues") from None
    remember_places(index, index_project(index), folders_of(logs))
