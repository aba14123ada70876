"""A log as a Rerun recording: pictures through Rerun's own MCAP reader, curves as columns."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from common.files import refuse_existing
from recorder import Log
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.edit import recover
from recorder.topics import PILOT_COMMAND, VEHICLE
from viz.layout import CURVES, Curve, log_layout
from viz.rrd_file import rrd_file

TIMELINE: Final = "message_log_time"  # as Rerun's MCAP reader calls a message's log time

Values = NDArray[np.float64]


def save_rrd(path: Path, rrd: Path, *, overwrite: bool = False) -> str:
    """Write the log at `path`, its curves and its layout to the file `rrd`, without a window.

    Of a log that was never finished, what is whole is taken. The log's notice, empty for a finished one.
    Raises LogError if the log cannot be read, UserError if `rrd` exists and may not be overwritten, or where the
    disk is full.
    """
    refuse_existing(rrd, overwrite)
    with Log(path) as log:
        if not log.problem:
            _save(log, path.name, rrd, overwrite=overwrite)
            return ""
        # Rerun's reader refuses a log without a sound end.
        with tempfile.TemporaryDirectory(prefix="bc-play-") as folder:
            whole = recover(path, Path(folder) / "whole.mcap").path
            with Log(whole) as recovered:
                _save(recovered, path.name, rrd, overwrite=overwrite)
        return log.notice


def _save(log: Log, name: str, rrd: Path, *, overwrite: bool) -> None:
    drawn = list(curves(log))  # before Rerun starts: of a damaged log, it makes a hang
    layout = log_layout([topic for topic, count in log.counts.items() if count])
    recording_id = f"{name}-{log.fingerprint[:12]}"
    with rrd_file(rrd, overwrite=overwrite, recording_id=recording_id, layout=layout) as file:
        file.recording.send_recording_name(name)
        file.recording.log_file_from_path(log.path)
        for curve, time_ns, values in drawn:
            log_style(file.recording, curve)
            send_curve(file.recording, curve, time_ns, values)


def curves(log: Log) -> Iterator[tuple[Curve, NDArray[np.int64], Values]]:
    """The lines that a log has: which, log times (N,) in ns, values (N,)."""
    for topic, found in ((VEHICLE, list(log.vehicle_states())), (PILOT_COMMAND, list(log.commands()))):
        time_ns = np.array([message.log_time_ns for message, _ in found], np.int64)
        if len(time_ns):
            contents = [content for _, content in found]
            yield from ((curve, time_ns, values) for curve, values in curve_values(topic, contents))


def curve_values(topic: str, contents: Sequence[VehicleState | PilotCommand]) -> Iterator[tuple[Curve, Values]]:
    """The lines that are drawn of the messages on `topic`, a value a message."""
    for curve in CURVES:
        if curve.topic == topic:
            yield curve, np.array([getattr(content, curve.field) for content in contents], np.float64)


def log_style(recording: rr.RecordingStream, curve: Curve) -> None:
    recording.log(curve.entity, rr.SeriesLines(names=curve.name, colors=[curve.color], widths=1.5), static=True)


def send_curve(recording: rr.RecordingStream, curve: Curve, time_ns: NDArray[np.int64], values: Values) -> None:
    recording.send_columns(curve.entity, [time_column(time_ns)], rr.Scalars.columns(scalars=values))


def time_column(time_ns: NDArray[np.int64]) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, timestamp=time_ns.astype("datetime64[ns]"))
