"""The flags of an import that name topics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Topics:
    """Topics of another program's log, or features of a dataset."""

    image: Annotated[str | None, tyro.conf.arg(metavar="TOPIC")] = None
    """Topic of the pictures, or a LeRobot dataset's feature."""
    steering: Annotated[str | None, tyro.conf.arg(metavar="TOPIC.FIELD")] = None
    """The steering: /cmd_vel.angular.z; for LeRobot: action.steering."""
    steering_scale: float = 1.0
    """Factor to -1 (left) .. 1 (right); negative for ROS."""
