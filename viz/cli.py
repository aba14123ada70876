"""`bc-play`: a log, or the training of a run, in the Rerun viewer."""

from __future__ import annotations

import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from common import UserError
from common.command import DONE, run_command, stderr, warn, warn_skipped

if TYPE_CHECKING:
    from viz.viewer import Ports


@dataclass(frozen=True)
class Play:
    """Open a log in the Rerun viewer: cameras, the network's crop, steering, speed.

    Of a run's folder, it shows how training went: losses, errors beside those of constant predictors, and by bin.
    Without a display, the viewer is served to browsers on this machine.
    """

    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
    """The log to open, finished or not, or the folder of a run (runs/NAME)."""
    follow: bool = False
    """Show a log that is being written, or a run that is being trained, as it grows."""
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
    shown: _Log | _Training = _Training(config) if _is_run(config) else _Log(config)
    if config.save is not None:
        code = shown.save(config.save)
        print(f"{config.save}: written; open it with `rerun {config.save}`")
        return code
    return show(config, shown)


def _is_run(config: Play) -> bool:
    """Whether it is a run's folder, or will be: --follow waits for a run, but not for a log."""
    if config.log.is_dir():
        return True
    is_awaited = config.follow and config.save is None and not os.path.lexists(config.log)
    return is_awaited and ".mcap" not in config.log.suffixes


class _Log:
    """A log to show."""

    def __init__(self, config: Play) -> None:
        from viz.growing import find_log, is_finished

        if not config.log.exists() and (Path("runs") / config.log).is_dir():
            raise UserError(f"{config.log}: no log; to see how a run was trained, `bc-play runs/{config.log}`")
        self.path = find_log(config.log) if config.follow else config.log
        self.is_growing = config.follow and not is_finished(self.path)
        self._config = config

    def save(self, rrd: Path) -> int:
        from viz.follow import save_growing
        from viz.playback import save_rrd

        if not self.is_growing:
            return _told(save_rrd(self.path, rrd, overwrite=self._config.force))
        followed = save_growing(self.path, rrd, overwrite=self._config.force)
        return max(_told(followed.notice), warn_skipped(followed.skipped))

    def follow(self, viewer: subprocess.Popen[bytes], ports: Ports) -> int:
        from viz.follow import follow

        return follow(self.path, viewer, ports)


class _Training:
    """A run whose training is to be shown."""

    def __init__(self, config: Play) -> None:
        self.path = config.log
        self.is_growing = config.follow
        self._config = config

    def save(self, rrd: Path) -> int:
        from viz.training import save_training, wait_until_trained

        if self.is_growing:
            wait_until_trained(self.path)
        return warn_skipped(save_training(self.path, rrd, overwrite=self._config.force))

    def follow(self, viewer: subprocess.Popen[bytes], ports: Ports) -> int:
        from viz.training import follow_training

        return follow_training(self.path, viewer, ports)


def show(config: Play, shown: _Log | _Training) -> int:
    from viz.follow import VIEWER_MEMORY
    from viz.viewer import Ports, free_port, has_display, open_viewer, wait_until_closed

    web = config.web or not has_display()
    # A window gets a port of its own: several may be open beside each other.
    ports = Ports(config.web_port, config.port if web else free_port())
    with tempfile.TemporaryDirectory(prefix="bc-play-") as folder:
        rrd = None if shown.is_growing else Path(folder) / f"{shown.path.absolute().name}.rrd"
        code = DONE if rrd is None else shown.save(rrd)
        with open_viewer(rrd, ports, web=web, memory=VIEWER_MEMORY if shown.is_growing else None) as viewer:
            if web:
                print(ports.web_address, flush=True)
                stderr().print("bc-play: open that address in a browser; Ctrl-C ends")
            if shown.is_growing:
                return shown.follow(viewer, ports)
            wait_until_closed(viewer)
            return code


def _told(notice: str) -> int:
    """Print what a log that was never finished has to say; the exit code that says so."""
    return warn(notice) if notice else DONE


def main() -> None:
    run_command("bc-play", Play, play)


if __name__ == "__main__":  # how bc-record and bc-train start it
    main()
