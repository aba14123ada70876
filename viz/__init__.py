"""Seeing it: logs in the Rerun viewer, with a layout that fits what they hold."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from viz.follow import save_growing
    from viz.layout import log_layout
    from viz.playback import curves, save_rrd

__all__ = ["curves", "log_layout", "save_growing", "save_rrd"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "curves": "viz.playback",
        "log_layout": "viz.layout",
        "save_growing": "viz.follow",
        "save_rrd": "viz.playback",
    },
)
