"""The style of the studies' figures. Matplotlib is imported only when a figure is drawn."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI: Final = 200
# Okabe and Ito (2008): distinguishable for colour-blind people, and in grey
BLUE, ORANGE = "#0072B2", "#E69F00"

_STYLE: Final[Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
}


@contextlib.contextmanager
def figure_style() -> Iterator[None]:
    """Use the style for figures that are drawn and saved in the block. A user's matplotlibrc does not change
    them."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def new_figure(height_inches: float) -> Figure:
    """An empty figure as wide as a page's text."""
    from matplotlib.figure import Figure

    return Figure((7.0, round(height_inches, 2)), layout="constrained")
