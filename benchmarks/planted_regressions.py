"""What `bc-eval --compare` finds out: regressions planted in a good run, and how often it cries wolf.

python benchmarks/planted_regressions.py RUN LOG... [--rounded 0.01 0.02 0.05] [--shift 5] [--exchanges 400]

The run is measured on all of the logs beside copies of itself: its weights rounded to multiples of a number, its
colours swapped, and its crop cut out some pixels of the camera's picture farther down, up, right and left. Then
the answers of it and of a copy are exchanged at random in each block, so that neither is better: how often is B
called worse, with so many blocks?
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.picture_spec import PictureSpec
from dataset.preprocess import Image, decode, preprocess
from model.evaluation.differences import compare_sums, overall
from model.evaluation.evaluate import Evaluation, evaluate_sessions
from model.evaluation.predict import BATCH, predict_crops
from model.evaluation.run_comparison import MEASURES, Comparison, measures_of_sums, sums_of_blocks
from model.network.picture_network import PictureNetwork
from model.runs.run_folder import load_network, save_weights
from recorder import Log
from recorder.log.topics import camera_topic

FEW_BLOCKS: Final = (6, 10, 20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--rounded", type=float, nargs="+", default=[0.01, 0.02, 0.05])
    parser.add_argument("--shift", type=int, default=5, help="pixels of the camera's picture")
    parser.add_argument("--exchanges", type=int, default=400)
    arguments = parser.parse_args()
    good = evaluate_sessions(arguments.run, arguments.logs)
    with tempfile.TemporaryDirectory() as folder:
        planted = plant(arguments.run, Path(folder), arguments.rounded)
        steering, _ = predict_crops(list(planted.values()), partial(crops, good), len(good.frames))
    found = dict(zip(planted, steering, strict=True))
    for name, (right, down) in {"down": (0, 1), "up": (0, -1), "right": (1, 0), "left": (-1, 0)}.items():
        by_px = arguments.shift * right, arguments.shift * down
        (found[f"crop {arguments.shift} px {name}"],) = predict_crops(
            [arguments.run], partial(crops, good, by_px=by_px), len(good.frames)
        )[0]
    mean_deg = good.measures.mean.rmse_deg
    print(f"{len(good.frames):,} frames; RMSE of always the mean {mean_deg:.2f}\n")
    print(f"| planted | answers apart | {' | '.join(each.heading for each in MEASURES)} | verdict |")
    print("|" + "---|" * (len(MEASURES) + 3))
    for name, predicted in found.items():
        compared = Comparison(good, answering(good, predicted))
        cells = [f"{each.a:.2f} to {each.b:.2f}, {each.verdict}" for each in compared.differences]
        verdict = overall(compared.differences)
        print(f"| {name} | {compared.answers_apart_deg:.2f} | {' | '.join(cells)} | {verdict} |", flush=True)
    for blocks, share in false_alarms(compared, arguments.exchanges):
        print(f"no better and no worse, {blocks} blocks: called worse in {share:.1%} of {arguments.exchanges:,}")


def plant(run: Path, folder: Path, rounded: list[float]) -> Mapping[str, Path]:
    def swap(network: PictureNetwork) -> None:
        weight = network.state_dict()["features.0.weight"]
        weight.copy_(weight.flip(1))

    def to_multiples(step: float) -> Callable[[PictureNetwork], None]:
        def round_all(network: PictureNetwork) -> None:
            for tensor in network.state_dict().values():
                tensor.copy_((tensor / step).round() * step)

        return round_all

    kinds = {f"weights rounded to {step:g}": to_multiples(step) for step in rounded} | {"channels swapped": swap}
    found = {}
    for number, (name, change) in enumerate(kinds.items()):
        found[name] = folder / str(number)
        shutil.copytree(run, found[name], ignore=shutil.ignore_patterns("last"))
        network = load_network(run)
        change(network)
        save_weights(found[name], network.state_dict(), epoch=1)
    return found


def crops(
    of: Evaluation, seen: PictureSpec, by_px: tuple[int, int] = (0, 0)
) -> Iterator[tuple[NDArray[np.int64], Image]]:
    """The crops of the frames, cut out so many pixels of the camera's picture farther to the right and down."""
    right, down = by_px
    move = np.array([[1, 0, -right], [0, 1, -down]], np.float64)
    pictures = [
        cv2.warpAffine(picture, move, picture.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
        if right or down
        else picture
        for picture in pictures_of(of)
    ]
    for at in range(0, len(pictures), BATCH):
        part = np.stack([preprocess(picture.astype(np.uint8), seen) for picture in pictures[at : at + BATCH]])
        yield np.arange(at, at + len(part)), part


def pictures_of(of: Evaluation) -> Iterator[Image]:
    """The camera's picture of each frame, in their order."""
    columns = [of.frames[name].to_pylist() for name in ("session", "row", "camera")]
    at: dict[tuple[str, str], dict[int, tuple[int, int, int]]] = {}
    logs: dict[str, Log] = {}
    for session, row, camera in zip(*columns, strict=True):
        if session not in logs:
            logs[session] = Log(of.logs[session])
        if (session, camera) not in at:
            found = logs[session].pictures(camera_topic(camera))
            places = zip(*(each.tolist() for each in (found.offset, found.length, found.chunk)), strict=True)
            at[session, camera] = dict(zip(found.sequence.tolist(), places, strict=True))
        yield decode(logs[session].read(*at[session, camera][row]))
    for log in logs.values():
        log.close()


def answering(of: Evaluation, predicted: NDArray[np.float64]) -> Evaluation:
    """The same frames, answered otherwise."""
    position = of.frames.column_names.index("predicted")
    return replace(of, frames=of.frames.set_column(position, "predicted", pa.array(predicted)))


def false_alarms(compared: Comparison, exchanges: int) -> Iterator[tuple[int, float]]:
    """How often B is called worse although the two were exchanged at random in each block: numbers of blocks, and
    the share of the exchanges."""
    both = np.stack([sums_of_blocks(each.frames, compared.unit) for each in (compared.a, compared.b)])
    random = np.random.default_rng(0)
    for blocks in [few for few in FEW_BLOCKS if few < compared.unit_count] + [compared.unit_count]:
        worse = 0
        for _ in range(exchanges):
            taken = both[:, random.choice(compared.unit_count, blocks, replace=False)]
            is_exchanged = (random.random(blocks) < 0.5)[:, None]
            a, b = np.where(is_exchanged, taken[::-1], taken)
            worse += overall(compare_sums(a, b, MEASURES, measures_of_sums, 0.0)) == "worse"
        yield blocks, worse / exchanges


if __name__ == "__main__":
    main()
