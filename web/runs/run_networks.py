"""Networks of runs, as far as bc-web runs them: not code of one's own, which no user has named here."""

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
"""The files that a run's network is loaded from."""


def check_network(run: Path, log: Location, place: Location) -> None:
    """Raises WebError for a run whose network is code of one's own, with the command that shows it over a log, by
    the run's place, of which `run` may be a copy; RunError for a run of a later version, or an unreadable one."""
    config = load_config(run)
    if is_own_network(config):
        words = shlex.join(["bc-play", str(log), "--run", str(place)])
        command = f"{words} {network_flag(stored_network(config, run), run)}"
        raise WebError(
            f"{place}: its network is your own code, which runs only if you name it: use `{command}`", 409
        )


def can_be_run(run: Path) -> bool:
    """Whether bc-web runs the network of a run."""
    with contextlib.suppress(UserError):
        return not is_own_network(load_config(run))
    return False
