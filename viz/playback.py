"""A log as a Rerun recording: pictures through Rerun's own MCAP reader, curves as columns."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from common import whole_file
from recorder import Log
from viz import layout
from viz.layout import CURVES, Curve

APPLICATION: Final = "behavioural-cloning-toolkit"
TIMELINE: Final = "message_log_time"  # as Rerun's MCAP reader calls a message's log time

Values = NDArray[np.float64]


def save_rrd(path: Path, rrd: Path, *, overwrite: bool = False) -> None:
    """Write the log at `path`, its curves and its layout to the file `rrd`, without a window.

    Raises LogError if the log cannot be read, UserError if `rrd` exists and may not be overwritten.
    """
    with Log(path) as log, whole_file(rrd, overwrite=overwrite) as part:
        # Both come before Rerun starts: of a damaged log, or a folder that cannot be written, it makes a hang.
        drawn = list(curves(log))
        part.touch()
        recording = rr.RecordingStream(APPLICATION, recording_id=f"{path.name}-{log.fingerprint[:12]}")
        topics = [topic for topic, count in log.counts.items() if count]
        recording.save(part, default_blueprint=layout.log_layout(topics))
        recording.send_recording_name(path.name)
        recording.log_file_from_path(path)
        for curve, time_ns, values in drawn:
            _send(recording, curve, time_ns, values)
        recording.flush()
        recording.disconnect()


def curves(log: Log) -> Iterator[tuple[Curve, NDArray[np.int64], Values]]:
    """The lines that a log has: which, log times (N,) in ns, values (N,)."""
    vehicle = list(log.vehicle_states())
    commands = list(log.commands())
    vehicle_ns = np.array([message.log_time_ns for message, _ in vehicle], np.int64)
    command_ns = np.array([message.log_time_ns for message, _ in commands], np.int64)
    fields = {
        layout.STEERING_RECORDED: (vehicle_ns, [state.steering for _, state in vehicle]),
        layout.STEERING_PREDICTED: (command_ns, [command.predicted_steering for _, command in commands]),
        layout.STEERING_SENT: (command_ns, [command.steering for _, command in commands]),
        layout.SPEED_DRIVEN: (vehicle_ns, [state.speed_mph for _, state in vehicle]),
        layout.SPEED_SET: (command_ns, [command.set_speed_mph for _, command in commands]),
        layout.THROTTLE: (vehicle_ns, [state.throttle for _, state in vehicle]),
        layout.BRAKE: (vehicle_ns, [state.brake for _, state in vehicle]),
        layout.LATENCY: (command_ns, [command.total_ms for _, command in commands]),
    }
    for curve in CURVES:
        time_ns, values = fields[curve]
        if len(time_ns):
            yield curve, time_ns, np.array(values, np.float64)


def _send(recording: rr.RecordingStream, curve: Curve, time_ns: NDArray[np.int64], values: Values) -> None:
    recording.log(curve.entity, rr.SeriesLines(names=curve.name, colors=[curve.color], widths=1.5), static=True)
    recording.send_columns(
        curve.entity,
        indexes=[rr.TimeColumn(TIMELINE, timestamp=time_ns.astype("datetime64[ns]"))],
        columns=rr.Scalars.columns(scalars=values),
    )
