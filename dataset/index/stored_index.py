"""An index in a store: download it, build it on this machine, and upload it.

Readers use samples.parquet. It is uploaded first, and only if the store still has the version that was downloaded.
If two machines build at the same time, the second one gets an error. The other files only save work for the next
build: if they are not uploaded, that build reads some logs again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from common.errors import ObjectChangedError, UsageError
from common.location import Location, Url
from dataset.errors import DatasetError
from dataset.index.build_state import FRAMES_FOLDER, STATE_NAME
from dataset.samples.samples_format import SAMPLES_NAME

if TYPE_CHECKING:
    from common.stored_folder import StoredFolder


@contextlib.contextmanager
def index_here(index: Location, logs: Sequence[Location]) -> Iterator[tuple[Path, Callable[[], object]]]:
    """Yield the local folder in which to build an index, and a function that uploads the finished index to its
    store (and does nothing for a local index).

    Raises UsageError if the index is in a store and logs are on this machine, or in the index's folder. Raises
    DatasetError if another machine has changed the index, StoreError if the store fails.
    """
    if isinstance(index, Path):
        yield index, lambda: None
        return
    if local := next((log for log in logs if isinstance(log, Path)), None):
        raise UsageError(
            f"--index {index}: {local} is on this machine, and other machines could not read it; copy it to the"
            f" store with `bc-log copy`, and give --sessions {index.parent / 'sessions'}"
        )
    if within := next((log for log in logs if isinstance(log, Url) and log.is_in(index)), None):
        raise UsageError(
            f"--index {index}: contains the log {within}, but all files of an index are downloaded; give another"
            f" folder, such as --index {index / 'index'}"
        )
    from common.stored_folder import StoredFolder  # an extra

    with StoredFolder(index) as folder:
        folder.download()
        folder.remove_local(SAMPLES_NAME, STATE_NAME)  # from a build that could not be uploaded
        yield folder.local, lambda: _put(folder)


def frames_here(index: Location) -> Path:
    """The folder of an index's frames files; for an index in a store, a copy in the user's cache. Raises
    StoreError."""
    if isinstance(index, Path):
        return index / FRAMES_FOLDER
    from common.object_store import list_below  # an extra
    from common.stored_folder import StoredFolder

    objects = list_below(index)
    names = [entry.url.name_in(index) for entry in objects]
    with StoredFolder(index, waits=True) as folder:
        folder.download(objects=objects, wanted=[name for name in names if name.startswith(f"{FRAMES_FOLDER}/")])
        return folder.local / FRAMES_FOLDER


def _put(folder: StoredFolder) -> None:
    try:
        folder.upload(first=[SAMPLES_NAME, f"{FRAMES_FOLDER}/"])
    except ObjectChangedError as error:
        raise DatasetError(f"{error}; give the command again to continue") from None
