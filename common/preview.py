"""A live viewer in a separate process, next to the command that writes the log or the run."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
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
"""Arguments of Python that start the viewer; with -P, Python imports no modules from the working folder."""

EXIT_GRACE_S: Final = 2.0  # until the viewer is killed
FILE_GRACE_S: Final = 300.0  # for writing a file completely, also on a slow and busy machine
CONNECTED_GRACE_S: Final = 5.0  # for sending the rest to a running viewer
NOTICE_AFTER_S: Final = 2.0  # a longer wait is announced
_ADDRESS: Final = re.compile(r"[^-]:\d|^\d+$")
_NICENESS: Final = 10


def has_display() -> bool:
    """True if this machine can open a window."""
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
    """Show a log while the block writes it.

    `where` is "window" (without a display: "web"), "web", a file that ends in .rrd, or the address of a running
    viewer ("127.0.0.1:9876", or "connect" for Rerun's default port). A file or a running viewer receives all that
    the log has when the block ends: finish the log in the block.

    The viewer runs in a separate process: if it freezes or is closed, this process continues. The viewer has a
    lower priority; with `idle_priority` the lowest, so that it hardly runs on a busy machine. It has its own
    process group, and all of the group is killed if the viewer ignores the signal to end. It also ends when this
    process ends, which closes its stdin.

    `notify` prints a line if the viewer cannot be started, or if its end takes long; a viewer that fails later
    prints the reason on stderr. A viewer that is killed before its file is complete causes a warning.

    Raises UserError if the file exists and `overwrite` is false, UsageError for an invalid `where`.
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
            why = f"the viewer hung for {FILE_GRACE_S:g} s, or was killed"
            again = shlex.join(("bc-play", str(final_path(path)), "--save", str(file)))
            warn(f"{file}: not written: {why}; run `{again}`")


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
    """Wait for the viewer of a finished log, which ends by itself."""
    _restore_priority(viewer.pid)  # a user waits for it now
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(NOTICE_AFTER_S)
        return
    notify(f"{task}, {grace_s:g} s at most")
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(grace_s - NOTICE_AFTER_S)


def _parts_of(file: Path | None) -> set[Path]:
    """The temporary files of unfinished writes of `file`."""
    with contextlib.suppress(OSError):  # the folder does not exist yet
        if file is not None:
            return {part for part in file.parent.iterdir() if part != file and final_path(part) == file}
    return set()


def _flags(where: str) -> list[str]:
    if where == "window":
        return []
    if where in ("web", "connect"):
        return [f"--{where}"]
    if where.endswith(".rrd"):
        return ["--save", where]
    if not _ADDRESS.search(where):
        raise UsageError(
            f"--viewer {where}: expected window, web, a FILE.rrd, or the address of a viewer, such as"
            " 127.0.0.1:9876"
        )
    return ["--connect", where]


def _lower_priority(process: int, idle_priority: bool) -> None:
    """Lower the priority. Call this before the process starts children, which inherit the priority."""
    if sys.platform == "win32":
        return
    with contextlib.suppress(OSError):
        own = os.getpriority(os.PRIO_PROCESS, 0)
        os.setpriority(os.PRIO_PROCESS, process, max(own, _NICENESS))
    if sys.platform == "linux" and idle_priority:
        # A process with the highest niceness still keeps a core for some milliseconds. On two cores, a viewer that
        # was only nice made the slowest hundredth of a drive's answers 1.5 times as long.
        with contextlib.suppress(OSError):
            os.sched_setscheduler(process, os.SCHED_IDLE, os.sched_param(0))
        _set_group_niceness(process, 19)


def _restore_priority(process: int) -> None:
    """Restore normal priority, as far as the system permits: next to busy programs the viewer would hardly run."""
    _set_group_niceness(process, 0)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            threads = [int(path.name) for path in Path(f"/proc/{process}/task").iterdir()]
            for thread in threads:
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
            for thread in threads:
                os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, 0))


def _set_group_niceness(process: int, niceness: int) -> None:
    """Set the niceness of the whole session of `process`. If Linux divides the cores among sessions (autogroup),
    the priority of a process counts only within its session, and the viewer has its own session."""
    with contextlib.suppress(OSError):  # this system has no autogroups
        Path(f"/proc/{process}/autogroup").write_text(f"{niceness}\n", encoding="ascii")
