"""Makes the pictures of the README and the docs.

    make pictures                                                          trains what bc-demo trains, once
    python docs/make_pictures.py --run runs/first --log sessions/a.mcap    with what there is

The pictures of the viewer need a graphics driver; on a bare server, Debian's package mesa-vulkan-drivers.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from common.car import MPS_PER_MPH
from drive.demo import Demo, demo
from recorder import Log
from track_pictures import FORM_VIEWS, Picture, form_view, hairpin_sheet, layout_sheet, track_sheet
from viewer_pictures import screenshot
from viz.playback.comparison import PLACE
from viz.timelines import LOG_TIME
from web.server.templates import FOLDER as STATIC_FILES

DEMO: Final = Path("demo/pictures")
TRACK: Final = "mountain"
SLOW_MPH, FAST_MPH = 10, 20
_COLORS: Final = 256
_LARGE_BYTES: Final = 450_000


@dataclass(frozen=True)
class Pictures:
    """Make the pictures of the docs, from a run, a session and drives of the run on the mountain track."""

    run: Path | None = None
    """The run that drives; by default, that of a demo, which is made if demo/pictures is not there."""
    log: Path | None = None
    """A session to show; by default, that of the demo."""
    laps: float = 0.2
    """How far the run drives."""
    curve: Path | None = None
    """What studies/learning_curve.py has trained; without it, that picture stays as it is."""
    folder: Path = Path(__file__).parent / "pictures"
    """Where pictures are written; existing ones are replaced."""


@dataclass(frozen=True)
class Made:
    """What is shown."""

    run: Path
    session: Path
    slow: Path
    fast: Path


def main(config: Pictures) -> None:
    config.folder.mkdir(parents=True, exist_ok=True)
    for name in ("lake", "mountain"):
        write(config.folder / f"{name}.png", track_sheet(name))
    for name in FORM_VIEWS:
        picture, quality = form_view(name), [cv2.IMWRITE_WEBP_QUALITY, 80]
        cv2.imwrite(str(STATIC_FILES / "tracks" / f"{name}.webp"), picture, quality)
    write(config.folder / "layout.png", layout_sheet())
    write(config.folder / "hairpins.png", hairpin_sheet())
    if config.curve is not None:
        script = Path(__file__).parent.parent / "studies" / "learning_curve.py"
        _python(str(script), str(config.curve), "--figure", str(config.folder / "learning-curve.png"))
    if (config.run is None or config.log is None) and not (DEMO / "drives").exists():
        shutil.rmtree(DEMO, ignore_errors=True)  # of one that was stopped before its drives
        demo(Demo(folder=DEMO, laps=config.laps))
    run, session = config.run or DEMO / "runs" / "demo", config.log or DEMO / "sessions" / f"{TRACK}.mcap"
    with tempfile.TemporaryDirectory() as folder:
        made = driven(run, session, config.laps, Path(folder))
        for name, picture in viewer_pictures(made, Path(folder)).items():
            write(config.folder / f"{name}.png", picture)
        write(config.folder / "video.png", video_picture(made, Path(folder)))
    docs = Path(__file__).parent
    _python(str(docs / "page_sheets.py"), str(run.parent.parent), "--folder", str(config.folder / "pages"))
    _python(str(docs / "moving_picture.py"))


def driven(run: Path, session: Path, laps: float, folder: Path) -> Made:
    """Let `run` drive at two speeds."""
    where = ["--tracks", TRACK, "--laps", f"{laps:g}", "--drives", str(folder)]
    _bc("drive.evaluation.eval_cli", "drive", str(run), *where, "--speed", str(SLOW_MPH), str(FAST_MPH))
    slow, fast = (next(folder.glob(f"*-{TRACK}-{mph}mph.mcap")) for mph in (SLOW_MPH, FAST_MPH))
    return Made(run, session, slow.rename(folder / "slow.mcap"), fast.rename(folder / "fast.mcap"))


def viewer_pictures(made: Made, folder: Path) -> dict[str, Picture]:
    """The viewer as it shows a session, a drive, two drives by place, and where a network looks."""
    predicted = ["--run", str(made.run), "--attention"]
    turn_s, turn_m = hardest_turn(made.slow)
    return {
        "session": played([made.session], [], folder, LOG_TIME, hardest_turn(made.session)[0]),
        "viewer": played([made.slow], [], folder, LOG_TIME, turn_s),
        "comparison": played([made.slow, made.fast], ["--by", "place"], folder, PLACE, 100 * turn_m),
        "attention": played([made.session], predicted, folder, LOG_TIME, hardest_turn(made.session)[0]),
    }


def played(logs: list[Path], flags: list[str], folder: Path, timeline: str, at: float) -> Picture:
    """The viewer with what bc-play makes of logs."""
    rrd = folder / "shown.rrd"
    _bc("viz.cli", *map(str, logs), *flags, "--save", str(rrd), "--force")
    return screenshot(rrd, timeline, at)


def video_picture(made: Made, folder: Path) -> Picture:
    """Two frames of a video with the instruments: at the beginning, and where it steers most."""
    video = folder / "drive.mp4"
    _bc("viz.cli", str(made.slow), "--video", str(video), "--overlay")
    with Log(made.slow) as log:
        start_ns, _ = log.time_range_ns
    read = cv2.VideoCapture(str(video))
    frames = []
    for at_s in (3.0, hardest_turn(made.slow)[0] - start_ns * 1e-9):
        read.set(cv2.CAP_PROP_POS_MSEC, 1000 * at_s)
        is_there, frame = read.read()
        if not is_there:
            raise SystemExit(f"{video}: has no frame at {at_s:.1f} s")
        frames.append(frame)
    return np.hstack(frames).astype(np.uint8)


def hardest_turn(log: Path) -> tuple[float, float]:
    """Where a log steers most: seconds since 1970, and metres from its start."""
    with Log(log) as opened:
        pairs = list(opened.vehicle_states())
    time_s = np.array([message.log_time_ns for message, _ in pairs], np.float64) * 1e-9
    speed_mps = MPS_PER_MPH * np.array([state.speed_mph for _, state in pairs], np.float64)
    place_m = np.concatenate([[0.0], np.cumsum(speed_mps[1:] * np.diff(time_s))])
    at = int(np.argmax(np.abs([state.steering for _, state in pairs])))
    return float(time_s[at]), float(place_m[at])


def write(path: Path, picture: NDArray[np.uint8]) -> None:
    """A PNG; of 256 colours if it would be large otherwise."""
    image = Image.fromarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
    encoded = _png(image)
    if len(encoded) > _LARGE_BYTES:
        encoded = _png(image.quantize(_COLORS))
    path.write_bytes(encoded)
    print(path)


def _png(image: Image.Image) -> bytes:
    encoded = io.BytesIO()
    image.save(encoded, "PNG", optimize=True)
    return encoded.getvalue()


def _bc(module: str, *arguments: str) -> None:
    """Run the command of a module."""
    _python("-c", f"from {module} import main; main()", *arguments)


def _python(*arguments: str) -> None:
    done = subprocess.run([sys.executable, *arguments], check=False)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(arguments)}: exit code {done.returncode}")


if __name__ == "__main__":
    main(tyro.cli(Pictures))
