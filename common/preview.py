"""A live viewer, in a process of its own, beside the command that writes the log or the run."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from common.command import warn
from common.errors import UsageError
from common.files import final_path, refuse_existing

VIEWER: Final = ("-P", "-c", "from behavioural_cloning_toolkit import viewer; viewer()")
"""Arguments of Python that start the viewer; -P: modules in the working folder are not taken for ours."""

EXIT_GRACE_S: Final = 2.0  # for it to end by itself
FILE_GRACE_S: Final = 300.0  # for a file to be written to its end, also on a slow and busy machine
CONNECTED_GRACE_S: Final = 5.0  # for a viewer that runs already to receive the end
NOTICE_AFTER_S: Final = 2.0  # a longer wait is announced
_ADDRESS: Final = re.compile(r"[^-]:\d|^\d+$")
_NICENESS: Final = 10


def has_display() -> bool:
    """True if a window can open here."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextlib.contextmanager
def preview(
    path: Path,
    where: str = "window",
    *,
    overwrite: bool = False,
    idle_priority: bool = False,
    notify: Callable[[str], object] = warn,
) -> Iterator[None]:
    """Show a log that is being written, while this lasts.

    `where` is "window" (without a display: "web"), "web", a file that ends in .rrd, or the address of a viewer
    that runs ("127.0.0.1:9876", or "connect" for one on Rerun's own port). The file, and the viewer that runs,
    have what was in the log when this is left: finish the log before.

    The viewer's process may freeze, or be closed, and this one goes on. It has a lower priority; with
    `idle_priority`, the lowest that there is: on a busy machine it hardly runs. It is in a process group of its
    own, so that nothing of it stays when it ignores its signal to end. Its stdin ends with this process: then it
    ends. `notify` prints a line if the viewer cannot be started, or if waiting for its end takes long; a viewer
    that fails later prints why on stderr. If it is killed before its file is whole, that is a warning.

    Raises UserError if the file is there already and may not be overwritten, UsageError for another `where`.
    """
    flags = _flags(where)
    file = Path(where) if where.endswith(".rrd") else None
    if file is not None:
        refuse_existing(file, overwrite)
        flags += ["--force"] if overwrite else []
    others = _parts_of(file)
    viewer = _start([sys.executable, *VIEWER, str(path), "--follow", *flags], notify)
    if viewer is None:
        yield
        return
    _lower_priority(viewer.pid, idle_priority)
    try:
        yield
    finally:
        try:
            if file is not None:
                _wait_for_end(viewer, f"finishing {file}", FILE_GRACE_S, notify)
            elif "--connect" in flags:
                _wait_for_end(viewer, "the viewer gets the rest", CONNECTED_GRACE_S, notify)
            viewer.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                viewer.wait(EXIT_GRACE_S)
        finally:  # also after a second Ctrl-C
            if sys.platform != "win32":
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(viewer.pid, signal.SIGKILL)
            viewer.kill()
            viewer.communicate()
        if file is not None and viewer.returncode < 0:
            for part in _parts_of(file) - others:
                part.unlink(missing_ok=True)
            why = f"its writing hung for {FILE_GRACE_S:g} s, or was killed"
            again = f"`bc-play {final_path(path)} --save {file}` makes it of the finished log"
            warn(f"{file}: not written: {why}; {again}")


def _start(command: list[str], notify: Callable[[str], object]) -> subprocess.Popen[bytes] | None:
    try:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=sys.stderr,
            start_new_session=True,
            creationflags=getattr(subprocess, "BELOW_NORMAL_PRIORITY_CLASS", 0),  # on Windows
        )
    except OSError as error:  # no memory, too many processes
        notify(f"viewer: cannot be started ({error.strerror}); everything else continues")
        return None


def _wait_for_end(
    viewer: subprocess.Popen[bytes], task: str, grace_s: float, notify: Callable[[str], object]
) -> None:
    """Wait for the viewer of a finished log, which ends by itself, even if it has just begun."""
    _restore_priority(viewer.pid)  # it is waited for
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(NOTICE_AFTER_S)
        return
    notify(f"{task}, {grace_s:g} s at most")
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(grace_s - NOTICE_AFTER_S)


def _parts_of(file: Path | None) -> set[Path]:
    """Files that are being written under a temporary name, to become `file`."""
    with contextlib.suppress(OSError):  # no such folder yet
        if file is not None:
            return {part for part in file.parent.iterdir() if part != file and final_path(part) == file}
    return set()


def _flags(where: str) -> list[str]:
    match where:
        case "window":
            return []
        case "web":
            return ["--web"]
        case "connect":
            return ["--connect"]
    if where.endswith(".rrd"):
        return ["--save", where]
    if not _ADDRESS.search(where):
        raise UsageError(
            f"--viewer {where}: neither window nor web, nor a FILE.rrd, nor the address of a viewer, such as"
            " 127.0.0.1:9876"
        )
    return ["--connect", where]


def _lower_priority(process: int, idle_priority: bool) -> None:
    """To be called before the process starts children, which inherit it."""
    if sys.platform == "win32":
        return
    with contextlib.suppress(OSError):
        own = os.getpriority(os.PRIO_PROCESS, 0)
        os.setpriority(os.PRIO_PROCESS, process, max(own, _NICENESS))
    if sys.platform == "linux" and idle_priority:
        # However nice, it would keep a processor for some milliseconds once it has one. On two cores the slowest
        # hundredth of a drive's answers took half as long again beside a viewer that was only nice.
        with contextlib.suppress(OSError):
            os.sched_setscheduler(process, os.SCHED_IDLE, os.sched_param(0))
        _set_group_niceness(process, 19)


def _restore_priority(process: int) -> None:
    """Restore normal priority, as far as the system permits: beside busy programs the viewer would hardly run."""
    _set_group_niceness(process, 0)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            threads = [int(path.name) for path in Path(f"/proc/{process}/task").iterdir()]
            for thread in threads:
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
            for thread in threads:
                os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, 0))


def _set_group_niceness(process: int, niceness: int) -> None:
    """Set the niceness of `process`'s whole session. Where Linux shares the processors out among sessions
    (autogroup), a process's own priority counts only within its session, and the viewer has one to itself."""
    with contextlib.suppress(OSError):  # there are no such groups here
        Path(f"/proc/{process}/autogroup").write_text(f"{niceness}\n", encoding="ascii")
