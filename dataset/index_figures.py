"""Three figures of an index for a paper: preprocessing, augmentation and balance.

    write_figures(Path("index"), Path("figures"))

Matplotlib is an extra: `pip install ".[figures]"`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.files import atomic_file, refuse_existing
from common.location import Location
from dataset.augment import alter
from dataset.config import IndexConfig
from dataset.errors import DatasetError, index_write_errors
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
from dataset.preprocessing import Image, decode, preprocess
from dataset.samples.samples_format import Balance
from dataset.samples.samples_reader import Samples

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMES: Final = ("preprocessing", "augmentation", "balance")
TURN: Final = 0.1  # steering from which a frame counts as a turn: 2.5 degrees

Kind = Literal["left turn", "straight", "right turn"]


@dataclass(frozen=True)
class Moment:
    """A camera picture and how the car was steered there."""

    kind: Kind
    steering: float  # -1..1, as a sample of this camera has it
    picture: Image  # (height, width, 3) BGR


@dataclass(frozen=True)
class Distribution:
    """Training samples in each steering bin; arrays of one length, from left to right."""

    before: NDArray[np.int64]
    originals: NDArray[np.int64]  # after balancing, without
    copies: NDArray[np.int64]  # the copies that fill up
    short: NDArray[np.int64]  # what the cap on copies left missing
    per_bin: int  # what the bins were brought to; 0 where nothing was balanced


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


def find_moments(samples: Samples, seed: int) -> list[Moment]:
    """A left turn, a straight stretch and a right turn of the centre camera, or of all if it has no picture.

    Each is drawn from that quarter of its kind whose steering is nearest to the median: the extremes are often
    somebody's way back to the road. A kind that was never driven is missing.
    """
    table = samples.table
    is_center = pc.equal(table["camera"].cast(pa.string()), "center").to_numpy()
    usable = is_center if is_center.any() else ~is_center
    steering = np.where(table["flip"].to_numpy(), -1.0, 1.0) * table["label"].to_numpy() + 0.0  # no -0.0
    kinds: dict[Kind, NDArray[np.bool_]] = {
        "left turn": steering <= -TURN,
        "straight": np.abs(steering) < TURN,
        "right turn": steering >= TURN,
    }
    random = np.random.default_rng(seed)
    moments = []
    for kind, is_kind in kinds.items():
        members = np.flatnonzero(is_kind & usable)
        if len(members):
            distance = np.abs(steering[members] - np.median(steering[members]))
            typical = members[np.argsort(distance, kind="stable")][: -(-len(members) // 4)]
            at = int(random.choice(typical))
            moments.append(Moment(kind, float(steering[at]), _picture(samples, at)))
    if not moments:
        raise _damaged(samples.path, "no sample to show")
    return moments


def _picture(samples: Samples, at: int) -> Image:
    (row,) = samples.table.slice(at, 1).to_pylist()
    log = samples.logs.get(row["session"])
    if log is None:
        raise _damaged(samples.path, f"no log of session {row['session']}")
    try:
        return decode(log.read(row["offset"], row["length"], row["chunk"]))
    except ValueError as error:
        raise DatasetError(f"{log.path}: row {row['row']}, {row['camera']} camera: {error}") from None


def steering_distribution(samples: Samples, config: IndexConfig) -> Distribution:
    """Count the training samples; what balancing left out of them, the index has noted."""
    training = samples.of_split("train")
    is_copy, bins = (training[name].to_numpy() for name in ("copy", "bin"))
    try:
        noted = Balance.from_dict(samples.metadata["balance"])
        short = np.array([noted.short.get(i, 0) for i in range(config.bins)], np.int64)
        originals, copies = (np.bincount(bins[is_copy == copy], minlength=config.bins) for copy in (0, 1))
        if not len(noted.before) == len(originals) == len(copies) == config.bins:
            raise ValueError(f"not {config.bins} bins")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _damaged(samples.path, error) from None
    return Distribution(noted.before, originals, copies, short, noted.per_bin)


def two_draws(crop: Image, names: str, seed: int) -> tuple[int, int]:
    """The seeds, out of twelve, of the two draws of an alteration that differ most: they show its range."""
    drawn = {seed + i: alter(crop, names, seed + i).astype(np.int16) for i in range(12)}
    return max(
        itertools.combinations(drawn, 2), key=lambda pair: int(np.abs(drawn[pair[0]] - drawn[pair[1]]).sum())
    )


def _damaged(path: Location, what: object) -> DatasetError:
    return DatasetError(f"{path}: damaged ({what}); build it again with `bc-index`")


def draw_preprocessing(moments: list[Moment]) -> Figure:
    """A row each: the picture with the crop's edges, the crop in its place, and what the network sees."""
    figure = new_figure(1.2 * len(moments) + 0.6)
    grid = figure.subplots(len(moments), 3, squeeze=False, width_ratios=(2, 2, 1))
    for axes, moment in zip(grid, moments, strict=True):
        height, width = moment.picture.shape[:2]
        rows = ORIGINAL.crop_slice(height)
        top, bottom = rows.start, rows.stop
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
