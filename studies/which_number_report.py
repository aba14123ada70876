"""Which number predicts how a network drives? The measures of the networks of which_number.py, and their ranks.

python studies/which_number_report.py studies/which_number.parquet FOLDER

makes the tables and the figure of docs/studies/which-number.md in FOLDER, from the stored measures.

Each measure is oriented so that more is worse. Spearman's rank correlation with bad driving is then 1 for a
measure that orders networks as driving does, and 0 for a measure that predicts nothing. Its confidence interval is
from a bootstrap over trainings, because networks of the same training are alike. "Within a recipe" answers the
question which epoch to keep: ranks are taken within each recipe, over its epochs and seeds, and then correlated.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from figure_style import BLUE, ORANGE, figure_style, new_figure
from numpy.typing import NDArray

from common.car import MAX_STEERING_DEG
from common.files import atomic_file
from model.metrics import measure
from model.runs.enough_to_drive import EDGES, Hand, wilson_interval

Floats = NDArray[np.float64]

KNOWN: Final = ("lake", "mountain")
OUTCOMES: Final = ("interventions a lap", "mean offset", "autonomy lost, %")
DRAWS: Final = 500
DATA: Final = "which_number.parquet"
HANDS: Final[dict[Hand, str]] = {"keys": "people", "smooth": "expert"}
"""The recordings on which an error is measured; "people" stands for the keyboard driver."""


def write(folder: Path) -> None:
    """Write FOLDER/which_number.parquet, .md and .png, and print the tables."""
    predicted = {path.stem for path in (folder / "predictions").glob("*.parquet")}
    driven = {path.stem for path in (folder / "driven").glob("*.jsonl")}
    networks = sorted(predicted & driven)
    if not networks:
        raise SystemExit(f"{folder}: no network in it is measured yet")
    rows = [row for network in networks for row in rows_of(folder, network)]
    with atomic_file(folder / DATA, overwrite=True) as part:
        pq.write_table(pa.Table.from_pylist(rows), part)
    write_report(rows, folder)


def write_report(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Write FOLDER/which_number.md and .png of these measures, and print the tables."""
    wide = pivot(rows)
    table = correlations(wide)
    text = "\n".join([*driving_of_recipes(rows), "", *staying(rows, wide), "", *markdown(wide, table)]) + "\n"
    with atomic_file(folder / "which_number.md", overwrite=True) as part:
        part.write_text(text)
    print(text)
    if len(wide) > 2:
        draw(wide, table, folder / "which_number.png")


def rows_of(folder: Path, network: str) -> list[dict[str, Any]]:
    """The measures of a network, one row each."""
    training, epoch = network.rsplit("-e", 1)
    recipe, seed = training.rsplit("-s", 1)
    about = {"network": network, "recipe": recipe, "seed": int(seed), "epoch": int(epoch)}
    values: list[tuple[str, str, str, float]] = []
    frames = pq.read_table(folder / "predictions" / f"{network}.parquet").to_pandas()
    for driver in ("keyboard", "expert"):
        part = frames[frames["session"].str.contains(f"-{driver}-")]
        values += [("offline", driver, name, value) for name, value in offline(part).items()]
        for session, of_one in part.groupby("session"):
            error = measure(of_one["predicted"].to_numpy(), of_one["recorded"].to_numpy()).driving_error
            values.append(("recording", str(session), "driving error", error))
    for line in (folder / "driven" / f"{network}.jsonl").read_text().splitlines():
        drive = json.loads(line)
        numbers = [(name, float(value)) for name, value in drive.items() if is_number(value)]
        values += [("driven", drive["track"], name, value) for name, value in numbers]
    return [
        {**about, "kind": kind, "where": where, "measure": name, "value": value}
        for kind, where, name, value in values
    ]


def is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, str)


def offline(frames: pd.DataFrame) -> dict[str, float]:
    """All offline measures of predictions, oriented so that more is worse; angles in degrees."""
    predicted, recorded = frames["predicted"].to_numpy(), frames["recorded"].to_numpy()
    measures = measure(predicted, recorded)
    spread, centred = predicted - predicted.mean(), recorded - recorded.mean()
    has_spread = float(spread @ spread) > 1e-9
    slope = float(spread @ centred / (spread @ spread)) if has_spread else 0.0
    r = measures.network.correlation if has_spread else 0.0
    sigma_deg = measures.mean.rmse_deg
    smooth = by_session(frames, lambda part: smoothed(part, 0.5))
    second = by_session(frames, lambda part: smoothed(part, 1.0))
    change = by_session(frames, lambda part: part["predicted"].diff().fillna(0.0))
    actual = by_session(frames, lambda part: part["recorded"].rolling(11, center=True, min_periods=1).mean())
    return {
        "RMSE": measures.network.rmse_deg,
        "MAE": measures.network.mae_deg,
        "MAE on turns": measures.network.turning_mae_deg,
        "balanced RMSE": measures.balanced_rmse_deg,
        "1 - correlation": 1 - r,
        "RMSE at the best scale": sigma_deg * math.sqrt(max(0.0, 1 - r * r)) if r > 0 else sigma_deg,
        "scale that is missing": abs(math.log(min(max(slope, 0.05), 20.0))),
        "bias": MAX_STEERING_DEG * abs(float((predicted - recorded).mean())),
        "RMSE, smoothed over 0.5 s": rmse_deg(smooth, recorded),
        "RMSE, both smoothed over 1 s": rmse_deg(second, actual),
        "roughness": MAX_STEERING_DEG * float(np.abs(change).mean()),
        "RMSE and correlation": measures.network.rmse_deg / sigma_deg + (1 - r),
        "RMSE times balanced RMSE": math.sqrt(measures.network.rmse_deg * measures.balanced_rmse_deg),
        "balanced RMSE and correlation": measures.balanced_rmse_deg / measures.mean_balanced_rmse_deg + (1 - r),
    }


def by_session(frames: pd.DataFrame, values: Callable[[pd.DataFrame], pd.Series[float]]) -> Floats:
    return np.concatenate([values(part).to_numpy() for _, part in frames.groupby("session", sort=False)])


def smoothed(part: pd.DataFrame, seconds: float) -> pd.Series[float]:
    """The mean prediction over `seconds` around each frame, at 10 Hz."""
    return part["predicted"].rolling(round(10 * seconds) + 1, center=True, min_periods=1).mean()


def rmse_deg(predicted: Floats, recorded: Floats) -> float:
    return MAX_STEERING_DEG * float(np.sqrt(np.mean(np.square(predicted - recorded))))


def pivot(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each network: its offline measures by driver, and `OUTCOMES`."""
    long = pd.DataFrame(rows)
    index = ["network", "recipe", "seed", "epoch"]
    offline_part = long[long["kind"] == "offline"]
    names = (
        offline_part["measure"]
        + " ("
        + offline_part["where"].map({"keyboard": "people", "expert": "expert"})
        + ")"
    )
    wide = offline_part.assign(name=names).pivot_table("value", index, "name", sort=False)
    driven = sums_of(long[long["kind"] == "driven"], index)
    wide["interventions a lap"] = driven["interventions"] / driven["laps"].clip(lower=0.01)
    lost_s = 6.0 * driven["interventions"]
    wide["autonomy lost, %"] = 100 * (lost_s / driven["elapsed_s"]).clip(upper=1.0)
    offsets = long[(long["kind"] == "driven") & (long["measure"] == "mean_offset")]
    wide["mean offset"] = offsets.groupby(index)["value"].mean()
    return wide.reset_index()


def sums_of(long: pd.DataFrame, index: list[str]) -> pd.DataFrame:
    return long.pivot_table("value", index, "measure", aggfunc="sum")


def correlations(wide: pd.DataFrame) -> pd.DataFrame:
    """One row for each offline measure and outcome: Spearman's correlation over all networks and within recipes,
    with their 95 % intervals."""
    about = {"network", "recipe", "seed", "epoch", *OUTCOMES}
    names = [name for name in wide.columns if name not in about]
    training = pd.factorize(wide["recipe"] + "-" + wide["seed"].astype(str))[0]
    members = [np.flatnonzero(training == number) for number in range(training.max() + 1)]
    generator = np.random.default_rng(0)
    draws = [generator.integers(0, len(members), len(members)) for _ in range(DRAWS)]
    recipe = pd.factorize(wide["recipe"])[0]
    table = []
    for outcome in OUTCOMES:
        for name in names:
            x, y = wide[name].to_numpy(np.float64), wide[outcome].to_numpy(np.float64)
            row: dict[str, Any] = {"outcome": outcome, "measure": name}
            for label, rank_correlation in (("all", spearman), ("within", spearman_within)):
                drawn = [
                    rank_correlation(x[at], y[at], recipe[at])
                    for at in (np.concatenate([members[n] for n in d]) for d in draws)
                ]
                finite = [value for value in drawn if math.isfinite(value)]
                low, high = np.quantile(finite, [0.025, 0.975]) if finite else (math.nan, math.nan)
                row |= {label: rank_correlation(x, y, recipe), f"{label} low": low, f"{label} high": high}
            table.append(row)
    return pd.DataFrame(table)


def spearman(x: Floats, y: Floats, _: NDArray[np.intp]) -> float:
    return correlation(ranks(x), ranks(y))


def spearman_within(x: Floats, y: Floats, group: NDArray[np.intp]) -> float:
    """The correlation of ranks within each group, divided by the size of the group, and centred within it."""
    a, b = np.zeros(len(x)), np.zeros(len(x))
    for number in np.unique(group):
        at = np.flatnonzero(group == number)
        for values, to in ((x, a), (y, b)):
            shares = ranks(values[at]) / len(at)
            to[at] = shares - shares.mean()
    return correlation(a, b)


def ranks(values: Floats) -> Floats:
    """The ranks of values, from 1. Equal values get the mean of their ranks."""
    _, number, count = np.unique(np.round(values, 9), return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    return np.asarray((last - (count - 1) / 2)[number], np.float64)


def correlation(a: Floats, b: Floats) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) > 0 and np.ptp(b) > 0 else math.nan


def driving_of_recipes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A table of each recipe's drives after the last epoch, on partly learnt and on unseen tracks: the mean,
    minimum and maximum over seeds."""
    long = pd.DataFrame(rows)
    long = long[(long["kind"] == "driven") & (long["epoch"] == long.groupby("recipe")["epoch"].transform("max"))]
    parts = {"known": long["where"].isin(KNOWN), "unseen": ~long["where"].isin(KNOWN)}
    headings = [f"{part}: {name}" for part in parts for name in ("interventions a lap", "mean offset")]
    lines = [f"| recipe | seeds | {' | '.join(headings)} |", "|---" * (2 + len(headings)) + "|"]
    for recipe, seeds in long.groupby("recipe", sort=False)["seed"].nunique().items():
        cells = []
        for is_in in parts.values():
            part = long[is_in & (long["recipe"] == recipe)]
            sums = sums_of(part, ["seed"])
            cells.append(mean_and_range(sums["interventions"] / sums["laps"].clip(lower=0.01)))
            cells.append(mean_and_range(part[part["measure"] == "mean_offset"].groupby("seed")["value"].mean()))
        lines.append(f"| {recipe} | {seeds} | {' | '.join(cells)} |")
    return lines


def staying(rows: Sequence[Mapping[str, Any]], wide: pd.DataFrame) -> list[str]:
    """A table of the networks by driving error, and how many of them needed no intervention on any road. Its
    counts are in `model.runs.enough_to_drive.STUDY`."""
    long = pd.DataFrame(rows)
    driven = long[(long["kind"] == "driven") & (long["measure"] == "interventions")]
    has_stayed = wide["network"].map(driven.groupby("network")["value"].sum()).to_numpy() == 0
    lines = ["| recordings | driving error | networks | stayed on the road | share, 95 % |", "|---" * 5 + "|"]
    for hand, people in HANDS.items():
        error = wide[f"balanced RMSE and correlation ({people})"].to_numpy(np.float64)
        bounds = (0.0, *EDGES[hand], math.inf)
        for low, high in itertools.pairwise(bounds):
            stayed = has_stayed[(low <= error) & (error < high)]
            if not len(stayed):
                continue
            low_share, high_share = wilson_interval(int(stayed.sum()), len(stayed))
            words = (
                f"{low:g} and more" if high == math.inf else f"{low:g} to {high:g}" if low else f"below {high:g}"
            )
            share = f"{100 * stayed.mean():.0f} % ({100 * low_share:.0f} to {100 * high_share:.0f})"
            lines.append(f"| {hand} | {words} | {len(stayed)} | {stayed.sum()} | {share} |")
    single = long[long["kind"] == "recording"]
    for hand, driver in (("keys", "keyboard"), ("smooth", "expert")):
        part = single[single["where"].str.contains(f"-{driver}-")]
        has_left = part["network"].isin(wide["network"][~has_stayed])
        for words, errors in (("stayed", part["value"][~has_left]), ("left", part["value"][has_left])):
            if len(errors):
                lines.append(f"- on one recording, {hand}: {words} with {errors.min():.2f} to {errors.max():.2f}")
    return lines


def mean_and_range(values: pd.Series[float]) -> str:
    return f"{values.mean():.2f} ({values.min():.2f} to {values.max():.2f})"


def markdown(wide: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    """The tables of the rank correlations of each measure."""
    lines = [f"{len(wide)} networks of {wide['recipe'].nunique()} recipes."]
    order = table[table["outcome"] == OUTCOMES[0]].sort_values("within", ascending=False)["measure"].tolist()
    for label, title in (("all", "over all networks"), ("within", "within a recipe")):
        lines += ["", f"Spearman's rank correlation {title}, with its 95 % interval:", ""]
        lines += [f"| measure | {' | '.join(OUTCOMES)} |", "|---" * (1 + len(OUTCOMES)) + "|"]
        for name in order:
            cells = []
            for outcome in OUTCOMES:
                (row,) = table[(table["measure"] == name) & (table["outcome"] == outcome)].to_dict("records")
                cells.append(f"{row[label]:.2f} ({row[f'{label} low']:.2f} to {row[f'{label} high']:.2f})")
            lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def draw(wide: pd.DataFrame, table: pd.DataFrame, path: Path) -> None:
    """Draw the figure. Left: the rank correlation of every measure with interventions, on recordings of people and
    of the expert. Right: interventions by two of the measures, one point for each network."""
    part = table[table["outcome"] == OUTCOMES[0]]
    names = [name.removesuffix(" (people)") for name in part["measure"] if name.endswith(" (people)")]
    names = sorted(names, key=lambda name: float(part.loc[part["measure"] == f"{name} (people)", "all"].iloc[0]))
    with figure_style():
        figure = new_figure(0.26 * len(names) + 0.8)
        ranks, *points = figure.subplots(1, 3, width_ratios=[1.6, 1, 1])
        for driver, color, shift in (("people", BLUE, 0.15), ("expert", ORANGE, -0.15)):
            rows = part.set_index("measure").loc[[f"{name} ({driver})" for name in names]]
            low, high = rows["all"] - rows["all low"], rows["all high"] - rows["all"]
            ranks.errorbar(
                rows["all"], np.arange(len(names)) + shift, xerr=np.clip([low, high], 0, None), fmt="o",
                color=color, markersize=3, label=f"on recordings of {driver.replace('expert', 'the expert')}",
            )  # fmt: skip
        ranks.axvline(0, color="0.7", linewidth=0.8)
        ranks.set_yticks(np.arange(len(names)), names)
        ranks.set(xlabel="rank correlation with interventions", xlim=(-1, 1))
        ranks.legend(loc="upper left", fontsize="x-small")
        for axes, name in zip(points, ("RMSE (people)", "balanced RMSE and correlation (people)"), strict=True):
            axes.plot(wide[name], wide[OUTCOMES[0]], "o", markersize=3, color=BLUE, alpha=0.6)
            axes.set(
                xlabel=name.removesuffix(" (people)").replace("balanced RMSE and correlation", "driving error")
            )
        points[0].set(ylabel=OUTCOMES[0])
        figure.savefig(path, dpi=200)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("measures", type=Path)
    parser.add_argument("folder", type=Path)
    chosen = parser.parse_args()
    write_report(pq.read_table(chosen.measures).to_pylist(), chosen.folder)
