"""The flags of an import that name topics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Topics:
    """The topics of another program's log, or features of a dataset, that are the pictures and the steering."""

    image: Annotated[str | None, tyro.conf.arg(metavar="TOPIC")] = None
    """Topic of the pictures in --from; in a LeRobot dataset, their feature."""
    steering: Annotated[str | None, tyro.conf.arg(metavar="TOPIC.FIELD")] = None
    """Topic and field of the steering: /cmd_vel.angular.z; of LeRobot: action.steering."""
    steering_scale: float = 1.0
    """Factor to -1 (left) .. 1 (right); negative for ROS."""
