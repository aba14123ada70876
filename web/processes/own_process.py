"""The command line of a process that runs a module of ours beside the server, however bc-web was started."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import behavioural_cloning_toolkit

_ROOT: Final = str(Path(behavioural_cloning_toolkit.__file__).parent)


def own_process(module: str, *words: str) -> list[str]:
    """Call `main()` of a module with these words as its arguments."""
    start = f"import sys; sys.path.append(sys.argv.pop(1)); from {module} import main; main()"
    return [sys.executable, "-P", "-c", start, _ROOT, *words]
