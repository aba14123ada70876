"""`bc-play`: a log in the Rerun viewer."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.command import DONE, run_command, stderr


@dataclass(frozen=True)
class Play:
    """Open a log in the Rerun viewer: cameras, the network's crop, steering, speed.

    Without a display, the viewer is served to browsers on this machine.
    """

    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
    """The log to open."""
    save: Path | None = None
    """Write an .rrd file for the Rerun viewer, and open nothing."""
    web: bool = False
    """Serve the viewer to browsers on this machine, also where there is a display."""
    web_port: int = 9090
    """Port of the page."""
    port: int = 9876
    """Port from which the page gets its data."""
    force: bool = False
    """Replace the file given to --save."""


def play(config: Play) -> int:
    from viz.playback import save_rrd
    from viz.viewer import has_display, open_viewer, web_address

    if config.save is not None:
        save_rrd(config.log, config.save, overwrite=config.force)
        print(f"{config.save}: written; open it with `rerun {config.save}`")
        return DONE
    web = config.web or not has_display()
    with tempfile.TemporaryDirectory(prefix="bc-play-") as folder:
        rrd = Path(folder) / f"{config.log.name}.rrd"
        save_rrd(config.log, rrd)
        with open_viewer(rrd, web=web, web_port=config.web_port, port=config.port) as viewer:
            if web:
                print(web_address(config.web_port, config.port), flush=True)
                stderr().print("bc-play: open that address in a browser; Ctrl-C ends")
            return viewer.wait()


def main() -> None:
    run_command("bc-play", Play, play)
