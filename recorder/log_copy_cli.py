"""`bc-log copy`: copies logs to and from a store."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common import UserError
from common.command import DONE, FAILED, print_error, warn
from common.errors import UsageError, as_user_error, counted
from common.location import Location, Url
from common.location_flag import LocationFlag
from common.output import print_message, print_next, print_result
from recorder.log_flag import logs_at, named_log


@dataclass(frozen=True)
class CopyLogs:
    """Copy logs and tags to or from a bucket, and compare every CRC. The same command
    continues a stopped download, and skips logs that are there."""

    places: Annotated[tuple[LocationFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...] TO")]
    """Logs or folders of logs, then the target: a folder, a URL, or a new name."""
    force: bool = False
    """Replace logs and tags of the same names."""

    def run(self) -> int:
        if len(self.places) < 2:
            raise UsageError("give the logs and where to: `bc-log copy sessions/lake.mcap s3://BUCKET/sessions`")
        logs, to = [named_log(place, takes_folders=True) for place in self.places[:-1]], self.places[-1]
        code = copy_logs(logs, to, overwrite=self.force)
        if code != FAILED:
            verb = "log check" if to.suffix == ".mcap" else "index --sessions"
            print_next(f"bc-{verb} {shlex.quote(str(to))}")
        return code


def copy_logs(places: Sequence[Location], to: Location, *, overwrite: bool = False, prog: str = "bc-log") -> int:
    """Copy logs and folders of logs, also after a failure; the worst of the exit codes."""
    from common.progress import progress_bar, progress_task
    from recorder.log.known_lag import lag_path
    from recorder.log.tags import tags_path

    pairs = _pairs(places, to)
    for log, target in pairs:
        if isinstance(log, Path) and isinstance(target, Path):
            files = [(log, target), (tags_path(log), tags_path(target)), (lag_path(log), lag_path(target))]
            copies = " && ".join(
                shlex.join(["cp", *map(str, pair)]) for pair in files if Path(str(pair[0])).is_file()
            )
            raise UserError(f"{log} and {target}: both are on this machine; copy with `{copies}`")
    from recorder.upkeep.copy_log import copy_log  # obstore, an extra

    codes = [DONE]
    with progress_bar() as bar:
        for number, (log, target) in enumerate(pairs, start=1):
            of_many = f" ({number} of {len(pairs)})" if len(pairs) > 1 else ""
            try:
                with progress_task(bar, f"copying {log.name}{of_many}, bytes", size_of(log)) as advance:
                    done = copy_log(log, target, overwrite=overwrite, on_bytes=advance)
            except OSError as error:
                codes.append(print_error(prog, _unreadable_or_full(log, target, error)))
                continue
            except Exception as error:
                codes.append(print_error(prog, as_user_error(log, error)))
                continue
            is_there = "" if done.is_new else ", was there already"
            print_result(f"{done.place}: {done.size / 1e6:,.1f} MB{is_there}")
            if done.notice:
                codes.append(warn(done.notice))
    if FAILED in codes and len(pairs) > 1:
        failed = codes.count(FAILED)
        print_message(f"{counted(failed, 'log')} of {len(pairs):,} not copied; the same command copies the rest")
    return FAILED if FAILED in codes else max(codes)


def _unreadable_or_full(log: Location, target: Location, error: OSError) -> UserError:
    if error.filename is None and isinstance(target, Path):
        return UserError(f"{target}: {error.strerror}; the same command continues")
    return UserError(f"{error.filename or log}: {error.strerror}")


def _pairs(places: Sequence[Location], to: Location) -> list[tuple[Location, Location]]:
    logs: list[Location] = []
    for place in places:
        inside = [log for log in logs_at(place) if log.suffix == ".mcap" or log == place]
        if not inside:
            raise UserError(f"{place}: no finished log in it")
        logs += inside
    if to.suffix != ".mcap":
        pairs = [(log, to / log.name) for log in logs]
    elif len(logs) == 1:
        pairs = [(logs[0], to)]
    else:
        raise UsageError(f"{to}: one log, but {len(logs):,} are given; give a folder")
    names = [target.name for _, target in pairs]
    if twice := {name for name in names if names.count(name) > 1}:
        raise UsageError(f"{min(twice)}: two logs have this name; copy them to different folders")
    return pairs


def size_of(log: Location) -> int | None:
    """The bytes of a log; None if it does not exist. Raises StoreError."""
    if isinstance(log, Url):
        from common.object_store import find_object

        stored = find_object(log)
        return stored.size if stored else None
    return log.stat().st_size if log.is_file() else None
