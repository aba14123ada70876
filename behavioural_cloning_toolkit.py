"""The entry points of all commands. Each imports its module when it is called."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module

from common.versions import VERSION

__version__ = VERSION


def viewer() -> None:
    """The viewer of another command, which starts it (`common.preview`)."""
    import_module("viz.preview_command").main()


def wheel_page() -> None:
    """The wheel page of another command, which starts it (`common.wheel_page`)."""
    import_module("web.cli").wheel_main()


def _command(prog: str, module: str) -> Callable[[], None]:
    """A `bc-` command: the `main` of a module."""

    def run() -> None:
        try:
            import_module(module).main()
        except KeyboardInterrupt:  # during the imports; later, `common.command` ends the command
            print(f"{prog}: stopped", file=sys.stderr)
            sys.exit(130)

    return run


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
