"""What somebody else has recorded: which kind it is, and who reads it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recorder.donkeycar import import_tub, is_tub
from recorder.errors import RecordingError
from recorder.foreign import ForeignTopics, import_foreign, is_foreign
from recorder.record import Imported, import_udacity


@dataclass(frozen=True)
class Topics:
    """Where in another program's log the pictures and the steering are."""

    image: Annotated[str | None, tyro.conf.arg(metavar="TOPIC")] = None
    """Topic of the pictures, in the log of another program that --from names."""
    steering: Annotated[str | None, tyro.conf.arg(metavar="TOPIC.FIELD")] = None
    """Topic and field of the steering, such as /cmd_vel.angular.z."""
    steering_scale: float = 1.0
    """What makes -1 (left) .. 1 (right) of that field; ROS counts left as positive: a negative scale."""


def import_from(
    source: Path,
    log: Path,
    topics: Topics | None = None,
    *,
    rate_hz: float | None = None,
    overwrite: bool = False,
) -> Imported:
    """Write what is at `source` to `log`: a Udacity recording, a DonkeyCar tub (`rate_hz` for those that tell no
    times), another program's MCAP log or a ROS 2 bag (which need `topics`).

    Raises RecordingError if it is none of them or nothing in it can be used, and UserError if `log` exists and
    `overwrite` is off.
    """
    topics = topics or Topics()
    if is_foreign(source):
        if rate_hz is not None:
            raise RecordingError(f"{source}: --rate: its messages tell their times; leave it out")
        if topics.image is None or topics.steering is None:
            raise RecordingError(
                f"{source}: which topics? Give --image TOPIC and --steering TOPIC.FIELD;"
                f" `bc-log info {source}` lists them"
            )
        chosen = ForeignTopics(topics.image, topics.steering, topics.steering_scale)
        return import_foreign(source, log, chosen, overwrite=overwrite)
    if topics != Topics():
        raise RecordingError(f"{source}: --image and --steering are for other programs' logs, which this is not")
    if is_tub(source):
        return import_tub(source, log, rate_hz=rate_hz, overwrite=overwrite)
    return import_udacity(source, log, rate_hz=rate_hz, overwrite=overwrite)
