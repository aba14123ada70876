"""Screenshots of the real Rerun viewer, without a window.

It needs a graphics driver; on a bare server, Debian's package mesa-vulkan-drivers.
"""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from viz.viewer_process import LOCAL, end_viewer, free_port, viewer_program

Picture = NDArray[np.uint8]

WIDTH, HEIGHT = 1600, 900
TITLE_BAR: Final = 37  # rows of the window that are not the log's

_PATIENCE_S: Final = 60.0
_APART_S: Final = 1.0


def screenshot(rrd: Path, timeline: str, at: float) -> Picture:
    """The viewer (HEIGHT, WIDTH, 3) BGR, showing the recording `rrd` at a place of a time line: a number of a
    sequence if its name says centimetres, else seconds since 1970."""
    with _viewer() as client:
        client.open(str(rrd.absolute()))
        while client.get_state().loading:
            time.sleep(0.2)
        if timeline.endswith("_cm"):
            client.set_time(timeline, sequence=round(at), play_state="paused")
        else:
            client.set_time(timeline, timestamp=at, play_state="paused")
        return _still(client)[TITLE_BAR:]


def _still(client: ViewerClient) -> Picture:
    """The viewer's picture when it does not change any more: views decode on their own threads, and nothing shows
    when they are done."""
    before = b""
    for _ in range(round(_PATIENCE_S / _APART_S)):
        time.sleep(_APART_S)
        shown = client.take_screenshot()
        if shown == before:
            break
        before = shown
    picture = cv2.imdecode(np.frombuffer(before, np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise SystemExit("the viewer gave no picture")
    return picture.astype(np.uint8)


@contextlib.contextmanager
def _viewer() -> Iterator[ViewerClient]:
    port = free_port()
    command = [str(viewer_program()), "--headless", "--bind", LOCAL, "--port", str(port)]
    command += ["--hide-welcome-screen", "--window-size", f"{WIDTH}x{HEIGHT + TITLE_BAR}"]
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield _connected(f"rerun+http://{LOCAL}:{port}/proxy", viewer)
    finally:
        end_viewer(viewer)


def _connected(url: str, viewer: subprocess.Popen[bytes]) -> ViewerClient:
    """The viewer at `url`, which may still be starting."""
    deadline_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline_s and viewer.poll() is None:
        with contextlib.suppress(ConnectionError, RuntimeError):
            client = ViewerClient.connect(url)
            client.get_state()
            return client
        time.sleep(0.2)
    raise SystemExit("the viewer does not start: is there a graphics driver (mesa-vulkan-drivers)?")
