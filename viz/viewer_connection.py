"""Connect to a running viewer: check that it listens at an address and that its version fits."""

from __future__ import annotations

import contextlib
import re
import socket
import threading
from typing import Final
from urllib.parse import urlsplit

import rerun as rr

from common import UserError
from common.errors import UsageError
from common.grpc_probe import speaks_grpc
from viz.timelines import SINCE_START
from viz.viewer_process import LOCAL

DEFAULT_PORT: Final = 9876
"""The default port of Rerun's viewer."""

_PATIENCE_S: Final = 10.0  # for a slow and busy machine
_POLL_S: Final = 0.1
_PORT: Final = re.compile(r"[1-9]\d{0,4}")
_PLACE: Final = re.compile(r"(?:[\w.-]+|\[[\da-fA-F:]+\]):[1-9]\d{0,4}")


def viewer_url(address: str) -> str:
    """Rerun's URL of a viewer. `address` is "PORT", "HOST:PORT" or a Rerun URL; empty: the default port on this
    machine.

    Raises UsageError for anything else.
    """
    if not address or _PORT.fullmatch(address):
        return f"rerun+http://{LOCAL}:{address or DEFAULT_PORT}/proxy"
    if _PLACE.fullmatch(address):
        return f"rerun+http://{address}/proxy"
    with contextlib.suppress(ValueError):
        url = urlsplit(address)
        if url.scheme == "rerun+http" and url.path == "/proxy" and url.hostname and url.port:
            return address
    raise UsageError(
        f"--connect {address}: expected HOST:PORT, or PORT on this machine, for example {LOCAL}:{DEFAULT_PORT}"
    )


def check_viewer(url: str) -> str:
    """Check that a Rerun viewer of the right version listens at `url`. Returns a notice if the viewer does not
    give its version, else "". Rerun itself would only wait for five seconds.

    Raises UserError if no viewer listens, or if its version differs.
    """
    where = urlsplit(url).netloc
    _refuse_others(url, where)
    needed = f"version {rr.__version__} is needed: open it with `rerun` of bc-play's environment"
    try:
        version = _version(url)
    except (OSError, RuntimeError) as error:  # OSError: ConnectionError or TimeoutError
        if "Unimplemented" not in str(error):
            raise UserError(f"{where}: the viewer does not answer; open another one with `rerun`") from None
        # servers of `rerun --serve-web`, and old viewers
        return f"{where}: its version is unknown; {needed}"
    if version is not None and version.split(".")[:2] != rr.__version__.split(".")[:2]:
        raise UserError(f"{where}: a viewer of version {version}, but {needed}")
    return ""


def set_time(url: str, recording: rr.RecordingStream, at_s: float, stop: threading.Event) -> None:
    """Wait until the viewer at `url` has the data, then pause it at `at_s` seconds after the start. Returns early
    if `stop` is set. A server for browsers cannot be paused: its layout plays in a loop."""
    from rerun.experimental import ViewerClient

    client = ViewerClient.connect(url)
    name = recording.get_recording_id()
    try:
        while not stop.wait(_POLL_S):
            for shown in client.get_state().recordings:
                times = [line.name for line in shown.timelines]
                if name is not None and shown.store_id.endswith(name) and SINCE_START in times:
                    client.set_time(SINCE_START, duration=at_s, play_state="paused", recording=shown.store_id)
                    return
    except (OSError, RuntimeError):  # the viewer has no cursor, or is closed
        return


def _version(url: str) -> str | None:
    from rerun.experimental import ViewerClient

    return ViewerClient.connect(url).get_state().viewer_version


def _refuse_others(url: str, where: str) -> None:
    place = urlsplit(url)
    try:
        connection = socket.create_connection((place.hostname or LOCAL, place.port or DEFAULT_PORT), _PATIENCE_S)
    except (OSError, OverflowError, ValueError):
        raise UserError(f"{where}: no viewer listens; open one with `rerun --port PORT`") from None
    with connection:
        try:
            is_viewer = speaks_grpc(connection)
        except TimeoutError:
            raise UserError(
                f"{where}: no answer: the viewer is frozen, or another program listens on this port"
            ) from None
        except OSError:
            is_viewer = False
    if not is_viewer:
        raise UserError(
            f"{where}: the program on this port is not a Rerun viewer; open one with `rerun --port PORT`"
        )
