"""The networks that bc-web runs: not a user's own code, which runs only if a flag names it."""

from __future__ import annotations

import contextlib
import shlex
from pathlib import Path
from typing import Final

from common import UserError
from common.location import Location
from model.runs.network_of_run import is_own_network, network_flag, stored_network
from model.runs.run_config import load_config
from model.runs.run_files import CONFIG, WEIGHTS
from web.errors import WebError

NETWORK_FILES: Final = WEIGHTS, CONFIG
"""The files of a run's network."""


def check_network(run: Path, log: Location, place: Location) -> None:
    """Raise WebError for a run whose network is a user's own code, with the command that shows it over a log;
    RunError for an unreadable run. `run` may be a copy of the run at `place`."""
    config = load_config(run)
    if is_own_network(config):
        words = shlex.join(["bc-play", str(log), "--run", str(place)])
        command = f"{words} {network_flag(stored_network(config, run), run)}"
        raise WebError(
            f"{place}: the network is your own code, which runs only if you name it: use `{command}`", 409
        )


def can_be_run(run: Path) -> bool:
    """Whether bc-web runs the network of a run."""
    with contextlib.suppress(UserError):
        return not is_own_network(load_config(run))
    return False
