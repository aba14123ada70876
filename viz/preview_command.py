"""`bc-play` for `common.preview`: it ends when the process that started it ends."""

from __future__ import annotations

import shlex

from common import UserError
from common.command import INTERRUPTED, run_command
from common.files import final_path
from common.process_settings import end_with_parent
from viz.cli import play
from viz.config import Play
from viz.console import set_program_name

_NAME = "viewer"  # instead of bc-play, which the user has not called


def _show(config: Play) -> int:
    try:
        return play(config)
    except KeyboardInterrupt:  # the command that started it has ended it: no message
        return INTERRUPTED
    except UserError as error:
        if config.save is not None:
            raise
        again = f"bc-play {shlex.quote(str(final_path(config.log)))} --follow"
        another = f"`{again}` opens another viewer, `{again} --web` opens it in a browser"
        raise UserError(f"{error}; everything else continues; {another}") from None


def main() -> None:
    end_with_parent()
    set_program_name(_NAME)
    run_command(_NAME, Play, _show)
