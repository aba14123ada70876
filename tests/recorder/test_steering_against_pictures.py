"""Steering that contradicts the pictures is found without a network, and sound steering is left alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from common.stretches import stretches
from dataset.cli import main as bc_index
from dataset.frames.frame_flags import ImageFindings
from dataset.frames.frames_file import read_frames
from dataset.frames.image_check_cache import write_image_check
from recorder import Log
from recorder.import_cli import main as bc_import
from recorder.log.road_places import states_of
from recorder.log_cli import main as bc_log
from recorder.seen.picture_stretches import against_pictures
from recorder.upkeep.check import check
from tests.helpers.panorama import RATE_HZ, Seconds, hand, views, write_drive
from tests.helpers.udacity import call

ROWS = 600
WRONG_S = (20.0, 32.0)


def found_in(path: Path) -> list[tuple[int, int]]:
    with Log(path) as log:
        return stretches(against_pictures(log, states_of(log)))


def wrong_for_a_while(other: Callable[[Seconds], Seconds]) -> Callable[[Seconds], Seconds]:
    return lambda at_s: np.where((at_s >= WRONG_S[0]) & (at_s < WRONG_S[1]), other(at_s), hand(at_s))


@pytest.mark.parametrize("lag_s", [0.0, 0.3])
def test_mirrored_labels_are_found(lag_s: float, tmp_path: Path) -> None:
    wheel = wrong_for_a_while(lambda at_s: -hand(at_s))
    drive = write_drive(tmp_path / "a.mcap", views(ROWS), lambda at_s: wheel(at_s - lag_s))
    assert found_in(drive) == [pytest.approx([(at_s + lag_s) * RATE_HZ for at_s in WRONG_S], abs=10)]


@pytest.mark.parametrize("wrong_s", [(0.0, 36.0), (30.0, 60.0), (12.0, 48.0)])
def test_a_recording_of_which_half_is_mirrored_is_found(wrong_s: tuple[float, float], tmp_path: Path) -> None:
    def wheel(at_s: Seconds) -> Seconds:
        return hand(at_s) * np.where((at_s >= wrong_s[0]) & (at_s < wrong_s[1]), -1, 1)

    drive = write_drive(tmp_path / "a.mcap", views(ROWS), wheel)
    assert found_in(drive) == [pytest.approx([at_s * RATE_HZ for at_s in wrong_s], abs=15)]


def test_sound_labels_are_not(tmp_path: Path) -> None:
    """Nor those of a straight, of a standing car, or where pictures tell nothing."""
    assert found_in(write_drive(tmp_path / "sound.mcap", views(ROWS))) == []
    straight = wrong_for_a_while(np.zeros_like)
    assert found_in(write_drive(tmp_path / "straight.mcap", views(ROWS), straight)) == []
    assert found_in(write_drive(tmp_path / "slow.mcap", views(ROWS), speed_mph=1.0)) == []
    assert found_in(write_drive(tmp_path / "short.mcap", views(ROWS)[:5])) == []
    assert found_in(write_drive(tmp_path / "broken.mcap", [b"no picture"] * 100)) == []
    someone_else = np.random.default_rng(3).uniform(-1, 1, ROWS)
    assert found_in(write_drive(tmp_path / "other.mcap", views(ROWS), lambda at_s: someone_else)) == []


def turned_by(wheel: Callable[[Seconds], Seconds]) -> Callable[[Seconds], Seconds]:
    """The heading of a car that turns as much as this wheel says; a turn to the right makes it smaller."""
    return lambda at_s: -np.cumsum(wheel(at_s)) / RATE_HZ


def test_poses_decide_where_the_pictures_turn_the_other_way(tmp_path: Path) -> None:
    """In a gentle bend, the far field of a correct drive may do so."""
    wheel = wrong_for_a_while(lambda at_s: -hand(at_s))
    expected = [pytest.approx([at_s * RATE_HZ for at_s in WRONG_S], abs=10)]
    for name, heading_rad, found in (
        ("correct", turned_by(wheel), []),
        ("mirrored", turned_by(hand), expected),
        ("unknown", np.zeros_like, expected),  # the pictures decide
    ):
        drive = write_drive(tmp_path / f"{name}.mcap", views(ROWS), wheel, heading_rad=heading_rad)
        assert found_in(drive) == found
        assert len([odd for odd in check(drive).odd if odd.kind == "steering_against_pictures"]) == len(found)
    no_pictures = [b"no picture"] * ROWS
    drive = write_drive(tmp_path / "dark.mcap", no_pictures, wheel, heading_rad=turned_by(hand))
    assert found_in(drive) == expected


def test_the_check_of_a_log_and_the_frames_of_an_index_show_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wheel = wrong_for_a_while(lambda at_s: -hand(at_s))
    log = write_drive(tmp_path / "sessions" / "a.mcap", views(ROWS), wheel)
    ((first, last),) = found_in(log)
    assert call(bc_log, "check", log) == 3
    printed = capsys.readouterr().out
    assert f"steering against the pictures: rows {first} to {last}," in printed
    assert f"`bc-log tag {log} exclude --odd --look` excludes all that is sure" in printed
    assert call(bc_log, "check", log, "--no-look") == 0

    index = tmp_path / "index"
    places = ("--sessions", log.parent, "--index", index, "--labels", "as-recorded")
    assert call(bc_index, *places) == 0
    assert flagged_rows(index) == []  # nobody has looked
    with Log(log) as opened:  # what an earlier version has found, which did not compare
        write_image_check(index, "a", opened.fingerprint, ImageFindings(ROWS, {}, {}))
    assert call(bc_index, *places, "--look") == 0
    assert flagged_rows(index) == list(range(first, last + 1))


def test_a_check_names_a_recording_that_is_mirrored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_drive(tmp_path / "a.mcap", views(700), lambda at_s: -hand(at_s))
    assert call(bc_log, "check", log) == 3
    printed = capsys.readouterr().out
    assert "700 pictures decoded: 1 finding\n" in printed
    assert "  sessions whose pictures turn the other way: 1 (all rows; is left right?)\n" in printed


@pytest.mark.parametrize("side", [1, -1])
def test_an_index_reports_that_a_session_is_mirrored(
    side: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    steering = side * hand(np.arange(700) / RATE_HZ)
    lines = [f"{row}.jpg,{row / RATE_HZ},{steering[row]},15" for row in range(700)]
    for row, picture in enumerate(views(700)):
        (tmp_path / f"{row}.jpg").write_bytes(picture)
    csv = tmp_path / "drive.csv"
    csv.write_text("\n".join(["image,t,steering,mph", *lines]))
    columns = ("image=image", "time_s=t", "steering=steering", "speed_mph=mph")
    assert call(bc_import, csv, "a", "--columns", *columns, "--sessions", tmp_path / "sessions") == 0
    assert call(bc_index, "--sessions", tmp_path / "sessions", "--index", tmp_path / "index") == 0
    assert ("a: its pictures turn the other way" in capsys.readouterr().err) is (side < 0)


def flagged_rows(index: Path) -> list[int]:
    """The rows of the only session whose steering contradicts the pictures."""
    frames = read_frames(index / "frames" / "a.parquet").to_pylist()
    return sorted({frame["row"] for frame in frames if "steering_against_pictures" in frame["flags"]})
