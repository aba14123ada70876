"""A drive is data again: the index knows who drove each frame, and can take only what was taken over."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from dataset import IndexConfig, Indexed, build_index
from dataset.cli import main
from dataset.frames.frames_table import is_for_training
from dataset.index.leaks import find_leaks
from recorder import Log, LogWriter
from recorder.bc_pb2 import PilotCommand, VehicleState
from tests.helpers.driving import one_line_in
from tests.helpers.logs import START_NS, write_log
from tests.helpers.udacity import call

STEP_NS = 40_000_000  # 25 telemetries a second
P, H, X = PilotCommand.PILOT, PilotCommand.HUMAN, PilotCommand.EXPERT
NAMES = {0: "", P: "pilot", H: "human", X: "expert"}
TAKEOVERS = IndexConfig(drives="takeovers", flip=False, balance=False, gap_s=0.2)


@dataclass(frozen=True)
class Row:
    """A frame of a drive: what the wheels did, what was sent, and by whom; None: nothing was noted."""

    wheels: float
    sent: float
    driver: int | None


def driven(*stretches: tuple[int | None, int]) -> list[Row]:
    """Stretches of so many rows by each driver. The wheels follow what is sent by 0.1 s, as a car's do."""
    drivers = [driver for driver, rows in stretches for _ in range(rows)]
    return [
        Row(round(0.5 * math.sin((i - 2.5) / 9), 4), round(0.5 * math.sin(i / 9), 4), driver)
        for i, driver in enumerate(drivers)
    ]


def write_drive(path: Path, rows: Sequence[Row], start_ns: int = START_NS, **jpegs: bytes) -> Path:
    """A log as a drive writes it: the centre camera, the crop, the vehicle and the command."""
    with LogWriter(path, {"source": "drive", "driver": "pilot"}) as writer:
        for number, row in enumerate(rows):
            time_ns = start_ns + number * STEP_NS
            jpeg = jpegs.get("jpeg", b"") + f"{path.stem} {number}".encode()
            writer.picture("center", time_ns, number, jpeg)
            writer.vehicle(time_ns, number, VehicleState(steering=row.wheels, throttle=0.2, speed_mph=9.0))
            writer.crop(time_ns, number, b"\x89PNG")
            if row.driver is not None:
                command = PilotCommand(predicted_steering=0.9, steering=row.sent, expert_steering=0.7)
                command.driver = row.driver  # type: ignore[assignment]
                writer.command(time_ns, number, command)
    return path


def rows_of(indexed: Indexed, name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(indexed.path / f"{name}.parquet").to_pylist()
    return rows


def index_of(folder: Path, rows: Sequence[Row], config: IndexConfig) -> Indexed:
    return build_index([write_drive(folder / "drive.mcap", rows)], folder / "index", config)


MIXED = driven((P, 100), (X, 60), (P, 200), (H, 50), (None, 20), (0, 10), (X, 60), (P, 50))


def test_each_frame_has_its_driver_and_takeovers_are_as_commanded(tmp_path: Path) -> None:
    frames = rows_of(index_of(tmp_path, MIXED, IndexConfig()), "frames/drive")
    assert [frame["driver"] for frame in frames] == [NAMES[row.driver or 0] for row in MIXED]
    assert [frame["steering"] for frame in frames] == [
        row.sent if row.driver in (H, X) else row.wheels for row in MIXED
    ]
    bins = [min(24, int((frame["steering"] + 1) * 12.5)) for frame in frames]
    assert [frame["bin"] for frame in frames] == bins


def test_a_command_belongs_to_the_picture_of_its_number_and_time(tmp_path: Path) -> None:
    """As a log may hold them that lost some: commands without a picture, and of another time."""
    path = tmp_path / "drive.mcap"
    with LogWriter(path, {"source": "drive"}) as writer:
        writer.command(START_NS - STEP_NS, 0, PilotCommand(driver=X, steering=0.9))
        for number in range(4):
            time_ns = START_NS + number * STEP_NS
            writer.picture("center", time_ns, number, b"%d" % number)
            writer.vehicle(time_ns, number, VehicleState(steering=0.1))
        writer.command(START_NS + STEP_NS, 1, PilotCommand(driver=-1, steering=0.8))  # type: ignore[arg-type]
        writer.command(START_NS + 2 * STEP_NS, 2, PilotCommand(driver=X, steering=0.5))
        writer.command(START_NS + 3 * STEP_NS, 3, PilotCommand(driver=7, steering=0.6))  # type: ignore[arg-type]
        writer.command(START_NS + 9 * STEP_NS, 9, PilotCommand(driver=X, steering=0.7))
    frames = rows_of(build_index([path], tmp_path / "index"), "frames/drive")
    assert [(frame["driver"], frame["steering"]) for frame in frames] == [
        ("", 0.1), ("", 0.1), ("expert", 0.5), ("", 0.1)
    ]  # fmt: skip


def test_takeovers_are_the_frames_that_an_expert_or_a_human_drove(tmp_path: Path) -> None:
    indexed = index_of(tmp_path, MIXED, TAKEOVERS)
    counts = indexed.counts["drive"]
    taken = [i for i, row in enumerate(MIXED) if row.driver in (H, X)]
    used = {sample["row"]: sample for sample in rows_of(indexed, "samples")}
    assert used.keys() <= set(taken)
    assert counts.training + counts.validation + counts.gap == len(taken)
    assert counts.not_taken_over == len(MIXED) - len(taken)
    assert counts.training + counts.validation == len(used) > 150
    for number, sample in used.items():
        row = MIXED[number]
        assert sample["label"] == (row.sent if row.driver in (H, X) else row.wheels)


def test_a_session_and_a_drive_make_one_index(tmp_path: Path) -> None:
    session = write_log(tmp_path / "session.mcap", [0.1 * math.sin(i / 5) for i in range(300)])
    drive = write_drive(tmp_path / "drive.mcap", MIXED)
    indexed = build_index([session, drive], tmp_path / "index", TAKEOVERS)
    assert indexed.counts["session"].not_taken_over == 0
    assert indexed.counts["session"].training > 500
    assert 0 < indexed.counts["drive"].training < 170
    assert indexed.counts["drive"].not_taken_over == 380
    assert find_leaks(indexed.path) == []


# Blocks: takeovers are short


def split_by_stretch(indexed: Indexed, rows: Sequence[Row]) -> list[set[str]]:
    """On which sides each takeover is."""
    split = {frame["row"]: frame["split"] for frame in rows_of(indexed, "frames/drive")}
    is_taken = [row.driver in (H, X) for row in rows]
    starts = [i for i, taken in enumerate(is_taken) if taken and (i == 0 or not is_taken[i - 1])]
    sides = []
    for start in starts:
        end = next((i for i in range(start, len(rows)) if not is_taken[i]), len(rows))
        sides.append({split[i] for i in range(start, end)})
    return sides


@pytest.mark.parametrize("seed", range(4))
def test_the_only_takeover_of_a_drive_is_for_training(tmp_path: Path, seed: int) -> None:
    rows = driven((P, 1000 + 50 * seed), (X, 100), (P, 1000))  # 4 s of 80; blocks are of 10 s
    indexed = index_of(tmp_path, rows, replace(TAKEOVERS, seed=seed, gap_s=1.0))
    counts = indexed.counts["drive"]
    assert (counts.training, counts.validation, counts.gap) == (100, 0, 0)


def test_a_short_takeover_is_on_one_side_and_both_sides_have_some(tmp_path: Path) -> None:
    rows = driven(*[(P, 330), (X, 110)] * 5, (P, 100))
    path = write_drive(tmp_path / "drive.mcap", rows)
    for seed in range(8):
        sides = split_by_stretch(build_index([path], tmp_path / "index", replace(TAKEOVERS, seed=seed)), rows)
        assert sorted(map(sorted, sides)) == [["train"]] * 4 + [["validation"]]  # a fifth of five


def test_a_long_takeover_is_blocks_like_any_session(tmp_path: Path) -> None:
    rows = driven((P, 300), (X, 3000), (P, 300))  # 120 s
    indexed = index_of(tmp_path, rows, replace(TAKEOVERS, gap_s=1.0))
    counts = indexed.counts["drive"]
    assert counts.validation == pytest.approx(600, abs=250)
    assert counts.training > 2000
    assert find_leaks(indexed.path) == []


def test_what_was_for_training_can_be_reported_from_the_log_again(tmp_path: Path) -> None:
    """`bc-eval` counts what a run has learnt from: it must find the split that the index had."""
    rows = driven(*[(P, 330), (X, 110)] * 5, (P, 100))
    for config in (TAKEOVERS, IndexConfig()):
        folder = tmp_path / config.drives
        folder.mkdir()
        indexed = index_of(folder, rows, config)
        with Log(folder / "drive.mcap") as log:
            learnt = is_for_training(indexed.frames, log, "drive", config)
        assert learnt.tolist() == [split == "train" for split in indexed.frames["split"].to_pylist()]


# Labels


def test_no_label_is_smoothed_over_the_edge_of_a_takeover(tmp_path: Path) -> None:
    """The pilot at 0.8, the expert at -0.4, a human at 0.1: a mean of two of them would be another number."""
    steering = {P: 0.8, X: -0.4, H: 0.1}
    drivers = [P] * 60 + [X] * 60 + [H] * 60 + [P] * 60
    rows = [Row(0.8 if driver == P else 0.1, steering[driver], driver) for driver in drivers]
    for number, config in enumerate((IndexConfig(label_smooth_s=1.0), replace(TAKEOVERS, label_smooth_s=1.0))):
        folder = tmp_path / str(number)
        folder.mkdir()
        indexed = index_of(folder, rows, replace(config, flip=False, balance=False))
        samples = rows_of(indexed, "samples")
        assert {sample["row"] // 60 for sample in samples} == ({0, 1, 2, 3} if number == 0 else {1, 2})
        for sample in samples:
            assert sample["label"] == pytest.approx(steering[drivers[sample["row"]]], abs=1e-9)


def test_a_shifted_label_is_of_the_same_takeover_or_none(tmp_path: Path) -> None:
    rows = driven((P, 100), (X, 100), (P, 100))
    indexed = index_of(tmp_path, rows, replace(TAKEOVERS, label_shift_s=0.2))
    labels = {sample["row"]: sample["label"] for sample in rows_of(indexed, "samples")}
    assert labels == {row: pytest.approx(rows[row + 5].sent) for row in range(100, 195)}
    assert indexed.counts["drive"].unlabelled == 5


# Bad input, and what is said


def test_without_a_takeover_a_person_leaves_no_pictures_and_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_drive(tmp_path / "drive.mcap", driven((P, 100)))
    assert call(main, path, "--index", tmp_path / "index", "--drives", "takeovers") == 1
    line = one_line_in(capsys)
    assert "no frame can be used: 100 driven by the network, not taken over (" in line
    assert "Udacity's simulator sends no pictures while a person holds keys" in line


def test_the_report_counts_what_was_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_drive(tmp_path / "drive.mcap", MIXED)
    assert call(main, path, "--index", tmp_path / "index") == 0
    assert "not taken over" not in " ".join(capsys.readouterr().out.split())
    for _ in range(2):  # the second time nothing is read again
        assert call(main, path, "--index", tmp_path / "index", "--drives", "takeovers") == 0
        (line,) = (line for line in capsys.readouterr().out.splitlines() if "drive" in line and "550" in line)
        assert "380" in line


def test_an_index_of_one_choice_is_built_again_for_the_other(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "drive.mcap", MIXED)
    built = [
        build_index([path], tmp_path / "index", config) for config in (replace(TAKEOVERS, drives="all"), TAKEOVERS)
    ]
    fresh = build_index([path], tmp_path / "fresh", TAKEOVERS)
    assert [indexed.counts["drive"].not_taken_over for indexed in built] == [0, 380]
    for name in ("frames/drive", "samples"):
        assert rows_of(built[1], name) == rows_of(fresh, name)
    again = build_index([path], tmp_path / "index", TAKEOVERS)
    assert (again.read, again.counts) == ([], built[1].counts)
