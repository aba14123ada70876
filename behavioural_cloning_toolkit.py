"""The entry points of all commands, and the check that the rooms' names are not taken by other packages.

The rooms have short names that others use, too: a student's own `model.py`, or another installed package. This
module's name is unique. Each room calls `refuse_hidden` before it imports those under it. Every command starts
here, so that Ctrl-C also works during its imports, which take a second or more.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Final, NoReturn

NEEDS: Final[dict[str, tuple[str, ...]]] = {
    "common": (),
    "simulator": ("common",),
    "recorder": ("common", "simulator"),
    "dataset": ("common", "simulator", "recorder"),
    "model": ("common", "simulator", "recorder", "dataset"),
    "viz": ("common", "simulator", "recorder", "dataset", "model"),
    "drive": ("common", "simulator", "recorder", "dataset", "model", "viz"),
    "web": ("common", "simulator", "recorder", "dataset", "model", "viz", "drive"),
}
"""The rooms under each room."""

_FAILED, _INTERRUPTED = 1, 130  # common.command's; nothing of ours is imported yet
_NO_MEMORY: Final = "not enough memory to begin; close other programs, or raise the limit (ulimit -v)"


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from common.versions import version_of

    return version_of()


def refuse_hidden(room: str) -> None:
    """Raise ImportError if something else is imported by the name of a room that `room` needs."""
    for name in NEEDS[room]:
        if line := _hidden_room_line(name):
            raise ImportError(line)


def viewer() -> None:
    """The viewer of another command, which starts it (`common.preview`)."""
    _import_main("viewer", "viz.preview_command")()


def wheel_page() -> None:
    """The wheel page of another command, which starts it (`common.wheel_page`)."""
    _import_main("bc-web", "web.wheel_command")()


def _command(prog: str, module: str) -> Callable[[], None]:
    """A `bc-` command: `module`'s main, and one line in place of a traceback until it runs."""

    def run() -> None:
        _hold_standard_streams()
        _end_tidily_on_signals(prog)
        main = _import_main(prog, module)
        try:
            main()
        except RuntimeError as error:  # raised before the command's own handler
            if "start new thread" not in str(error):
                raise
            _fail(prog, _NO_MEMORY)

    return run


def _import_main(prog: str, module: str) -> Callable[[], None]:
    """The `main` of one of our modules; ends the process with a line where it cannot be imported."""
    room = module.partition(".")[0]
    try:
        if line := _hidden_room_line(room):
            raise ImportError(line)
        main: Callable[[], None] = import_module(module).main
    except MemoryError:
        _fail(prog, _NO_MEMORY)
    except ImportError as error:
        if error.name is None:  # ours
            _fail(prog, str(error))
        if error.name.partition(".")[0] in NEEDS and (line := _owned_by_two()):
            _fail(prog, f"{error}: {line}")
        if "failed to map segment" in str(error):  # of a library that was to be loaded
            _fail(prog, _NO_MEMORY)
        raise
    return main


bc_record = _command("bc-record", "recorder.cli")
bc_import = _command("bc-import", "recorder.import_cli")
bc_log = _command("bc-log", "recorder.log_cli")
bc_copy = _command("bc-copy", "drive.copy_cli")
bc_index = _command("bc-index", "dataset.cli")
bc_train = _command("bc-train", "model.cli")
bc_drive = _command("bc-drive", "drive.cli")
bc_play = _command("bc-play", "viz.cli")
bc_sim = _command("bc-sim", "simulator.cli")
bc_runs = _command("bc-runs", "model.runs_cli")
bc_eval = _command("bc-eval", "drive.evaluation.eval_cli")
bc_demo = _command("bc-demo", "drive.demo")
bc_doctor = _command("bc-doctor", "drive.doctor_cli")
bc_web = _command("bc-web", "web.cli")


def _hidden_room_line(room: str) -> str | None:
    """A line about what is imported as `room` in place of ours; None if ours is."""
    loaded = sys.modules.get(room)
    spec = loaded.__spec__ if loaded is not None else find_spec(room)
    if spec is None:
        return None  # Python itself reports it as missing
    # a folder without an __init__.py has no origin
    origins = [place for place in (spec.origin, *(spec.submodule_search_locations or ())) if place is not None]
    ours = (Path(__file__).parent / room).resolve()
    if not origins or any(ours in (place := Path(name).resolve(), place.parent) for name in origins):
        return None if _is_intact(ours) else _overwritten(room)
    if owners := _owners(room):
        return _of_another(room, owners)
    return (
        f"{origins[0]} is in the way: Python takes it for this toolkit's `{room}`; rename it, or start Python in"
        " another folder (the bc- commands do not mind it)"
    )


def _is_intact(room: Path) -> bool:
    """False if another package that was installed into the same folder has replaced the room's __init__.py, or has
    taken it away when it was uninstalled. Ours name this module."""
    try:
        return __name__ in (room / "__init__.py").read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return not room.is_dir()  # in a zip file
    except OSError:
        return True


def _overwritten(room: str) -> str:
    if owners := _owners(room):
        names = ", ".join(owners)
        return (
            f"another installed package ({names}) has written its `{room}` over this toolkit's:"
            f" `pip uninstall {names}` and install the toolkit again, or install it into an environment of its own"
        )
    return f"this toolkit's `{room}` was overwritten by another package of that name: install the toolkit again"


def _owned_by_two() -> str | None:
    """A line about a package that has written its own files into a room of ours."""
    return next((_overwritten(room) for room in NEEDS if _owners(room)), None)


def _of_another(room: str, owners: list[str]) -> str:
    names = ", ".join(owners)
    return (
        f"`{room}` is also a name of another installed package ({names}), which hides this toolkit's:"
        f" `pip uninstall {names}`, or install the toolkit into an environment of its own"
    )


def _owners(room: str) -> list[str]:
    """The other distributions that have installed something under that name."""
    from importlib.metadata import packages_distributions  # reads the metadata of all of them

    return sorted(set(packages_distributions().get(room, ())) - {"behavioural-cloning-toolkit"})


def _hold_standard_streams() -> None:
    """A file that is opened must not get the number of a standard stream that is closed (`2>&-`): libraries print
    there, and would print into it."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one


def _end_tidily_on_signals(prog: str) -> None:
    """Until the command has handlers of its own. Nothing is begun yet that would have to be ended."""

    def end(number: int, frame: FrameType | None) -> NoReturn:
        try:
            if sys.platform != "win32":  # Python 3.11 has no set_blocking there
                os.set_blocking(2, False)  # a full pipe is not waited for
            os.write(2, f"{prog}: stopped\n".encode())
            if sys.platform != "win32":
                os.set_blocking(2, True)  # the terminal is the shell's as well
        finally:
            os._exit(_INTERRUPTED)

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # no SIGHUP on Windows; ignored: under nohup
        if number is not None and not (name == "SIGHUP" and signal.getsignal(number) == signal.SIG_IGN):
            signal.signal(number, end)


def _fail(prog: str, why: str) -> NoReturn:
    print(f"{prog}: {why}", file=sys.stderr)
    sys.exit(_FAILED)
