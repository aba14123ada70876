"""Visualization: logs in the Rerun viewer, with a layout for their topics."""

from typing import TYPE_CHECKING

from common.lazy import lazy_names

if TYPE_CHECKING:
    from viz.live.follow import save_growing as save_growing
    from viz.playback.blueprint import log_layout as log_layout
    from viz.playback.rerun_recording import curves as curves
    from viz.playback.rerun_recording import save_rrd as save_rrd

_HOMES = {
    "curves": "viz.playback.rerun_recording",
    "log_layout": "viz.playback.blueprint",
    "save_growing": "viz.live.follow",
    "save_rrd": "viz.playback.rerun_recording",
}
__all__ = [*_HOMES]
__getattr__, __dir__ = lazy_names(__name__, _HOMES)
