"""Seeing it: logs in the Rerun viewer, with a layout that fits what they hold."""

from viz.layout import log_layout
from viz.playback import curves, save_rrd

__all__ = ["curves", "log_layout", "save_rrd"]
