"""`bc-copy`: copies sessions, drives, indexes and runs to a store and back."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Annotated, Final, overload

import tyro

from common import UserError
from common.command import DONE, FAILED, print_error, run_command
from common.errors import UsageError
from common.location import Location, Url
from common.location_flag import LocationFlag
from common.output import print_message, print_result

_PROG: Final = "bc-copy"
_EVERY_S: Final = 60.0
"""Time between two copies of a run that is trained: equal to the time between two checkpoints."""


@dataclass(frozen=True)
class CopyPlaces:
    """Copy sessions, drives, indexes and runs to a bucket or from it: each log, index and run whole or not at all.

    bc-copy runs/night s3://my-bucket/runs/night
    bc-copy s3://my-bucket/sessions sessions

    What is there already is not copied again. Nothing is removed.
    """

    source: Annotated[LocationFlag, tyro.conf.Positional, tyro.conf.arg(metavar="FROM")]
    """A log, an index, a run, or a folder that contains them."""
    target: Annotated[LocationFlag, tyro.conf.Positional, tyro.conf.arg(metavar="TO")]
    """The place of the copy."""
    follow: bool = False
    """Copy a run every minute until its training ends."""
    unfinished: bool = False
    """Also bring an index or run whose upload was cut off."""
    force: bool = False
    """Replace logs, and all that the bucket holds under these names. An index or run of this machine is never
    replaced."""


def copy(config: CopyPlaces) -> int:
    source, target = config.source, config.target
    if isinstance(source, Path) and isinstance(target, Url):
        return _upload(source, target, config)
    if isinstance(source, Url) and isinstance(target, Path):
        return _download(source, target, config)
    raise UsageError(
        f"{source} and {target}: one place is on this machine, the other in a bucket: `bc-copy runs/night"
        " s3://BUCKET/runs/night`"
    )


def _upload(source: Path, target: Url, config: CopyPlaces) -> int:
    from common.folder_copy import FolderUpload, local_files  # obstore, an extra

    if not source.exists():
        raise UserError(f"{source}: no such log, index or run")
    if not source.is_dir():
        if config.follow:
            raise UsageError(f"--follow {source}: expected a run, or a folder of runs")
        return _copy_logs(source.parent, [PurePosixPath(source.name)], target, config.force)
    folders, logs = _parts(source, local_files(source))
    code = _copy_logs(source, logs, target, config.force)
    uploads = {folder: FolderUpload(source / folder, _below(target, folder)) for folder in folders}
    targets = [(folder, upload.url) for folder, upload in uploads.items()]
    is_followed = config.follow and _is_any_trained(source, folders)  # asked before: what follows is copied again
    copied = _copy_folders(targets, lambda folder: uploads[folder].copy(overwrite=config.force))
    if copied == FAILED or not is_followed:
        return _worst(code, copied)
    print_message(f"{target}: is copied every minute until the training ends")
    while is_followed:
        time.sleep(_EVERY_S)
        is_followed = _is_any_trained(source, folders)
        copied = _copy_folders(targets, lambda folder: uploads[folder].copy(), is_shown=False)
    return _worst(code, copied)


def _is_any_trained(source: Path, folders: Iterable[PurePosixPath]) -> bool:
    from model.runs.run_files import is_being_trained

    return any(is_being_trained(source / folder) for folder in folders)


def _download(source: Url, target: Path, config: CopyPlaces) -> int:
    from common.folder_copy import download_folder, stored_files  # obstore, an extra

    if config.follow:
        raise UsageError(f"--follow {source}: only a run of this machine can be followed")
    if source.suffix == ".mcap":
        return _copy_logs(source.parent, [PurePosixPath(source.name)], target, config.force)
    folders, logs = _parts(source, stored_files(source))
    code = _copy_logs(source, logs, target, config.force)
    copied = _copy_folders(
        [(folder, target / folder) for folder in folders],
        lambda folder: download_folder(_below(source, folder), target / folder, unfinished=config.unfinished),
    )
    return _worst(code, copied)


def _parts(source: Location, names: Iterable[str]) -> tuple[list[PurePosixPath], list[PurePosixPath]]:
    """The folders of indexes and runs, and the logs outside of them, relative to `source`."""
    from dataset.samples.samples_format import SAMPLES_NAME
    from model.runs.run_files import CONFIG

    paths = [PurePosixPath(name) for name in sorted(names)]
    marked = {path.parent for path in paths if path.name in (CONFIG, SAMPLES_NAME)}
    folders = [folder for folder in sorted(marked) if marked.isdisjoint(folder.parents)]
    logs = [path for path in paths if path.suffix == ".mcap" and marked.isdisjoint(path.parents)]
    if not folders and not logs:
        raise UserError(f"{source}: no log, index or run in it")
    return folders, logs


def _copy_logs(source: Location, logs: Iterable[PurePosixPath], target: Location, overwrite: bool) -> int:
    from recorder.log_copy_cli import copy_logs

    codes = [DONE]
    for folder, names in groupby(logs, lambda log: log.parent):
        places = [_below(source, name) for name in names]
        codes.append(copy_logs(places, _below(target, folder), overwrite=overwrite, prog=_PROG))
    return _worst(*codes)


def _worst(*codes: int) -> int:
    return FAILED if FAILED in codes else max(codes)


@overload
def _below(place: Path, name: PurePosixPath) -> Path: ...


@overload
def _below(place: Url, name: PurePosixPath) -> Url: ...


def _below(place: Location, name: PurePosixPath) -> Location:
    return place / str(name) if name.parts else place


def _copy_folders(
    targets: Iterable[tuple[PurePosixPath, Location]],
    copy_folder: Callable[[PurePosixPath], bool],
    *,
    is_shown: bool = True,
) -> int:
    """Copy indexes and runs, also after a failure. Returns the exit code."""
    code = DONE
    for folder, target in targets:
        try:
            is_new = copy_folder(folder)
        except UserError as error:
            code = print_error(_PROG, error)
        except OSError as error:
            code = print_error(_PROG, UserError(f"{error.filename or target}: {error.strerror}"))
        else:
            if is_shown:
                print_result(f"{target}: {'copied' if is_new else 'was there already'}")
    return code


def main() -> None:
    run_command(_PROG, CopyPlaces, copy)
