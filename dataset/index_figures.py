"""Three figures of an index for a paper: preprocessing, augmentation and balance.

    write_figures(Path("index"), Path("figures"))

Matplotlib is an extra: `pip install ".[figures]"`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from common.files import atomic_file, refuse_existing
from dataset.augment import alter
from dataset.config import IndexConfig
from dataset.errors import DatasetError, index_write_errors
from dataset.figure_data import Distribution, Moment, crop_rows, find_moments, steering_distribution, two_draws
from dataset.figure_style import (
    BLUE,
    DPI,
    GREY,
    ORANGE,
    WIDTH_INCHES,
    YELLOW,
    figure_style,
    new_figure,
    require_matplotlib,
)
from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image, preprocess
from dataset.samples.samples_reader import Samples

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMES: Final = ("preprocessing", "augmentation", "balance")


def check_figures(folder: Path | str, overwrite: bool = False) -> None:
    """Raise what `write_figures` could raise without an index: DatasetError if matplotlib is not installed or
    `folder` is none, UserError if a file exists already."""
    require_matplotlib(DatasetError)
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise DatasetError(f"{folder}: not a folder; give another name")
    for path in _paths(folder).values():
        refuse_existing(path, overwrite)


def write_figures(index: Path | str, folder: Path | str, *, seed: int = 0, overwrite: bool = False) -> list[Path]:
    """Write preprocessing, augmentation and balance, each as PNG (200 dpi) and PDF; their paths.

    `seed` chooses the frames and the alterations shown. Same index, seed and matplotlib: the same bytes.
    Raises DatasetError if the index or its logs cannot be used, or if matplotlib is not installed; UserError
    if a file exists already.
    """
    check_figures(folder, overwrite)
    paths = _paths(folder)
    with Samples(index) as samples:
        config = samples.settings
        moments = find_moments(samples, seed)
        distribution = steering_distribution(samples, config)
    turn = max(moments, key=lambda moment: abs(moment.steering))
    draw: dict[str, Callable[[], Figure]] = {
        "preprocessing": lambda: draw_preprocessing(moments),
        "augmentation": lambda: draw_augmentation(turn, config, seed),
        "balance": lambda: draw_balance(distribution, config),
    }
    with figure_style():
        for name in _NAMES:
            figure = draw[name]()
            for kind, metadata in (("png", None), ("pdf", {"CreationDate": None})):
                path = paths[name, kind]
                with index_write_errors(path), atomic_file(path, overwrite=overwrite) as part:
                    figure.savefig(part, format=kind, dpi=DPI, metadata=metadata)
                figure.set_layout_engine("none")  # the PDF as the PNG: an eighth of all time here
    return list(paths.values())


def _paths(folder: Path | str) -> dict[tuple[str, str], Path]:
    return {(name, kind): Path(folder) / f"{name}.{kind}" for name in _NAMES for kind in ("png", "pdf")}


def draw_preprocessing(moments: list[Moment]) -> Figure:
    """A row each: the picture with the crop's edges, the crop in its place, and what the network sees."""
    figure = new_figure(1.2 * len(moments) + 0.6)
    grid = figure.subplots(len(moments), 3, squeeze=False, width_ratios=(2, 2, 1))
    for axes, moment in zip(grid, moments, strict=True):
        height, width = moment.picture.shape[:2]
        top, bottom = crop_rows(height)
        camera, crop, network_input = axes
        _show(camera, moment.picture, (0, width, height, 0))
        for edge, cut in ((top, (0, top)), (bottom, (bottom, height))):
            camera.axhspan(*cut, color="black", alpha=0.4, linewidth=0)
            camera.axhline(edge, color=YELLOW, linewidth=1.2)
        _show(crop, moment.picture[top:bottom], (0, width, bottom, top))
        crop.set_ylim(height, 0)
        _show(network_input, preprocess(moment.picture), (0, ORIGINAL.width_px, ORIGINAL.height_px, 0))
        camera.set_yticks([0, height])  # the edges are beside it, at the crop
        crop.set_yticks([top, bottom])
        network_input.set_yticks([0, ORIGINAL.height_px])
        camera.set_ylabel(f"{moment.kind}\nsteering {_signed(moment.steering)}\nrow (px)")
    for panel, title in zip(grid[0], ("camera picture", "crop", "network’s input"), strict=True):
        panel.set_title(title)
    for panel in grid[:-1].flat:
        panel.set_xticks([])
    for panel in grid[-1]:
        panel.set_xticks(panel.get_xlim(), [f"{column:g}" for column in panel.get_xlim()])
        panel.set_xlabel("column (px)")
    grid[-1, 1].tick_params(axis="x", length=0, pad=5.5)  # far from the crop, they would mark nothing
    figure.align_labels()
    return figure


def draw_augmentation(moment: Moment, config: IndexConfig, seed: int) -> Figure:
    """A picture and its mirror image as the network sees them, plain and with each alteration of the index."""
    crop = preprocess(moment.picture)
    titles = {"": "unaltered", "+".join(config.alterations): "combined"} | {
        name: name for name in config.alterations
    }
    names = ["", *config.alterations, *(name for name in titles if "+" in name)]
    flips = (False, True) if config.flip else (False,)
    figure = new_figure((WIDTH_INCHES - 0.4) / len(names) * len(flips) + 0.3)
    grid = figure.subplots(len(flips), len(names), squeeze=False)
    for axes, name in zip(grid.T, names, strict=True):
        axes[0].set_title(titles[name])
        for panel, flipped, draw in zip(axes, flips, two_draws(crop, name, seed), strict=False):
            shown = np.ascontiguousarray(crop[:, ::-1]) if flipped else crop
            _show(panel, alter(shown, name, draw), (0, ORIGINAL.width_px, ORIGINAL.height_px, 0))
            panel.set_xticks([])
            panel.set_yticks([])
    for panel, flipped in zip(grid[:, 0], flips, strict=True):
        label = -moment.steering if flipped else moment.steering
        panel.set_ylabel(f"{'mirror image' if flipped else 'picture'}\nsteering {_signed(label)}")
    return figure


def draw_balance(distribution: Distribution, config: IndexConfig) -> Figure:
    """Training samples by steering: before, and after with the copies in another colour."""
    bins = len(distribution.before)
    edges = np.linspace(-1, 1, bins + 1)
    centers, width = (edges[:-1] + edges[1:]) / 2, 2 / bins * 0.9
    is_empty = distribution.before == 0
    target = f"{config.per_bin} of the bins that are not empty" if isinstance(config.per_bin, str) else "target"
    figure = new_figure(4.6)
    before, after = figure.subplots(2, 1, sharex=True)
    before.bar(
        centers,
        distribution.before,
        width,
        color=BLUE,
        label="recorded and mirrored" if config.flip else "recorded",
    )
    filled = np.zeros(bins, np.int64)
    for counts, label, style in (
        (distribution.originals, "originals", {"color": BLUE}),
        (distribution.copies, "altered copies" if config.alterations else "copies", {"color": ORANGE}),
        (distribution.short, "missing: the cap on copies", {"fill": False, "edgecolor": GREY, "hatch": "/////"}),
    ):
        if counts.any():
            after.bar(centers, counts, width, filled, label=label, linewidth=0.6, **style)
            filled = filled + counts
    for axes, title in ((before, "before balancing"), (after, "after balancing")):
        # the upper legend explains the line and the marks for both panels: what begins with "_" is in no legend
        hidden = "" if axes is before else "_"
        if distribution.per_bin:
            label = f"{hidden}{target}: {distribution.per_bin:,}"
            axes.axhline(distribution.per_bin, color="black", linewidth=1, linestyle="--", label=label)
        if is_empty.any():
            at, label = centers[is_empty], f"{hidden}empty bin"
            axes.plot(at, np.zeros(len(at)), "x", color=GREY, markersize=5, clip_on=False, label=label)
        axes.set_title(title, loc="left", fontweight="bold", pad=20)
        legend = axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, borderaxespad=0.3)
        legend.set_in_layout(False)
        axes.set_ylabel("training samples")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
        axes.set_xlim(-1.01, 1.01)
        axes.set_ylim(top=1.08 * axes.dataLim.ymax)
    after.set_xlabel("steering (−1: 25° to the left, 1: 25° to the right)")
    figure.align_ylabels()
    return figure


def _show(axes: Axes, picture: Image, extent: tuple[float, float, float, float]) -> None:
    axes.imshow(picture[:, :, ::-1], interpolation="none", extent=extent)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=2)


def _signed(steering: float) -> str:
    return f"{steering:+.2f}".replace("-", "−").replace("+0.00", "0.00").replace("−0.00", "0.00")
