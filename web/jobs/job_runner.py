"""The process of a job: it runs a command, and keeps the output and the exit code. It outlives bc-web.

It holds a lock while the command runs, so that no other process with the same number is taken for it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Final

from common.locks import lock

ABOUT, OUTPUT, EXIT, LOCK = "job.json", "output.txt", "exit", "lock"
"""The files of a job's folder: the request, the output, the exit code, and the lock held while it runs."""
READY: Final = b"ready\n"

_START: Final = "import sys; sys.path.append({root!r}); sys.argv[0] = {name!r}; " + (
    "from behavioural_cloning_toolkit import {function} as main; main()"
)


def main() -> None:
    """Run the commands of the job whose folder is the first argument, and wait for them. The toolkit is in `root`,
    installed or not."""
    folder, root = Path(sys.argv[1]), sys.argv[2]
    about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    signal.signal(signal.SIGINT, _leave_to_the_command)
    with (folder / LOCK).open("ab") as locked, (folder / OUTPUT).open("ab") as output:
        lock(locked)
        with os.fdopen(1, "wb") as parent:  # the pipe to the process that has started this one
            parent.write(READY)
        environment = {**os.environ, "COLUMNS": "160", "NO_COLOR": "1", "PYTHONUNBUFFERED": "1"}
        code = 0
        for name, *words in filter(None, (about["first"], about["words"])):
            start = _START.format(root=root, name=name, function=name.replace("-", "_"))
            code = subprocess.run(
                # -P: a `model.py` of the current folder is not imported
                [sys.executable, "-P", "-c", start, *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env=environment,
                check=False,
            ).returncode
            if code not in (0, 3):  # 3: something was skipped
                break
        part = folder / f"{EXIT}.part"
        part.write_text(str(code), encoding="utf-8")
        part.replace(folder / EXIT)


def _leave_to_the_command(number: int, frame: FrameType | None) -> None:
    """Ctrl-C is for the command, which is in the same process group. The command does not inherit a handler, but
    would inherit SIG_IGN."""
