"""Networks of runs, as far as bc-web runs them: not code of one's own, which no user has named here."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Final

from common.location import Location
from model.runs.run_files import CONFIG, WEIGHTS
from web.errors import WebError

NETWORK_FILES: Final = WEIGHTS, CONFIG
"""The files that a run's network is loaded from."""


def check_network(run: Path, log: Location, place: Location) -> None:
    """Raises WebError for a run whose network is code of one's own, with the command that shows it over a log, by
    the run's place, of which `run` may be a copy; RunError for a run of a later version, or an unreadable one."""
    from model.runs.network_of_run import is_own_network, network_flag, stored_network
    from model.runs.run_folder import load_config

    config = load_config(run)
    if is_own_network(config):
        words = shlex.join(["bc-play", str(log), "--run", str(place)])
        command = f"{words} {network_flag(stored_network(config, run), run)}"
        raise WebError(
            f"{place}: its network is your own code, which runs only if you name it: use `{command}`", 409
        )
