"""`bc-play`: a log in the Rerun viewer."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.command import DONE, run_command, stderr, warn, warn_skipped


@dataclass(frozen=True)
class Play:
    """Open a log in the Rerun viewer: cameras, the network's crop, steering, speed.

    Without a display, the viewer is served to browsers on this machine.
    """

    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
    """The log to open, finished or not."""
    follow: bool = False
    """Show a log that is being written, as it grows."""
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
    if config.follow:
        # A viewer that is closed while it gets data is no error; Rerun would write some on the terminal.
        os.environ.setdefault("RUST_LOG", "error,re_grpc_client=off,re_sdk=off")
    from viz.growing import find_log, is_finished

    log = find_log(config.log) if config.follow else config.log
    is_growing = config.follow and not is_finished(log)
    if config.save is not None:
        return save(config, log, config.save, is_growing=is_growing)
    return show(config, log, is_growing=is_growing)


def save(config: Play, log: Path, rrd: Path, *, is_growing: bool) -> int:
    from viz.follow import save_growing
    from viz.playback import save_rrd

    if is_growing:
        followed = save_growing(log, rrd, overwrite=config.force)
        code = max(_told(followed.notice), warn_skipped(followed.skipped))
    else:
        code = _told(save_rrd(log, rrd, overwrite=config.force))
    print(f"{rrd}: written; open it with `rerun {rrd}`")
    return code


def show(config: Play, log: Path, *, is_growing: bool) -> int:
    from viz.follow import VIEWER_MEMORY, follow
    from viz.playback import save_rrd
    from viz.viewer import Ports, free_port, has_display, open_viewer, wait_until_closed

    web = config.web or not has_display()
    # A window gets a port of its own: several may be open beside each other.
    ports = Ports(config.web_port, config.port if web else free_port())
    with tempfile.TemporaryDirectory(prefix="bc-play-") as folder:
        rrd = None if is_growing else Path(folder) / f"{log.name}.rrd"
        code = DONE if rrd is None else _told(save_rrd(log, rrd))
        with open_viewer(rrd, ports, web=web, memory=VIEWER_MEMORY if is_growing else None) as viewer:
            if web:
                print(ports.web_address, flush=True)
                stderr().print("bc-play: open that address in a browser; Ctrl-C ends")
            if is_growing:
                return follow(log, viewer, ports)
            wait_until_closed(viewer)
            return code


def _told(notice: str) -> int:
    """Print what a log that was never finished has to say; the exit code that says so."""
    return warn(notice) if notice else DONE


def main() -> None:
    run_command("bc-play", Play, play)


if __name__ == "__main__":  # how bc-record starts it
    main()
