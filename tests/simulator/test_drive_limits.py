"""A speed or a number of laps that is a slip of the finger is refused, with the reason."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from driving import one_line_in
from recorder.cli import main as bc_record
from simulator.cli import main as bc_sim
from udacity import call


@pytest.mark.parametrize(
    ("command", "flags", "expected"),
    [
        (
            bc_record,
            ["fast", "--speed", "500"],
            "--speed 500: expected a set speed above 0 mph and up to 100 (the car reaches",
        ),
        (
            bc_record,
            ["long", "--laps", "1000000"],
            "--laps 1e+06: expected a number above 0 and up to 1,000 (a lap takes some",
        ),
        (
            bc_record,
            ["me", "--driver", "me", "--speed", "500"],
            "--speed: with --driver me, give the one speed that",
        ),
        (bc_sim, ["--laps", "1000000"], "--laps 1e+06: give a number above 0 and up to 1,000"),
        (bc_sim, ["--expert-speed", "500"], "--expert-speed 500: give a set speed above 0 mph and up to 100"),
    ],
)
def test_what_nobody_means_is_refused(
    command: Callable[[], None], flags: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(command, *flags) == 2
    assert one_line_in(capsys).partition(": ")[2].startswith(expected)
