"""The style of figures for a paper: those of an index and those of a run look alike.

Matplotlib is an extra, and is imported only where a figure is drawn.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from common import UserError
from common.versions import install_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI: Final = 200
WIDTH_INCHES: Final = 7.0  # the text width of a page with two columns
# Okabe and Ito (2008): told apart by colour-blind people, and in grey
BLUE, ORANGE, GREEN, YELLOW, GREY = "#0072B2", "#E69F00", "#009E73", "#F0E442", "#595959"

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
    "hatch.linewidth": 0.6,
    "pdf.fonttype": 42,  # publishers refuse Type 3 fonts
}


def require_matplotlib(error: type[UserError]) -> None:
    """Raise `error`, which names the command that installs it, if matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise error(f"figures need matplotlib: install it with `{install_line('figures')}`") from None


@contextlib.contextmanager
def figure_style() -> Iterator[None]:
    """The style for what is drawn and saved within; somebody's own matplotlibrc does not change the bytes."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def new_figure(height_inches: float) -> Figure:
    """An empty figure as wide as a page's text."""
    from matplotlib.figure import Figure

    return Figure((WIDTH_INCHES, round(height_inches, 2)), layout="constrained")
