"""The tables that bc-index prints."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest

from common.output import print_table
from dataset.index.index_report import balance_table
from dataset.samples.samples_format import Balance


def printed(before: list[int], after: list[int], capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    print_table(balance_table(Balance(np.array(before), np.array(after), 3, {0: 2})))
    rows = (line.strip("│").split("│") for line in capsys.readouterr().out.splitlines() if line[0] == "│")
    return [[cell.strip() for cell in (row[0], row[1], row[3], row[5])] for row in rows]


def test_bins_that_are_alike_to_both_sides_are_shown_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed([1, 5, 8, 5, 1], [1, 3, 3, 3, 1], capsys) == [
        ["0.00 .. 0.20", "8", "3", ""],
        ["0.20 .. 0.60", "5", "3", ""],
        ["0.60 .. 1.00", "1", "1", ""],
    ]
    assert [row[0] for row in printed([1, 5, 5, 1], [1, 3, 3, 1], capsys)] == ["0.00 .. 0.50", "0.50 .. 1.00"]


def test_of_bins_that_differ_each_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed([1, 5, 0], [1, 3, 0], capsys) == [
        ["-1.00 .. -0.33", "1", "1", "2 short"],
        ["-0.33 .. +0.33", "5", "3", ""],
        ["+0.33 .. +1.00", "0", "0", "empty"],
    ]


def test_bars_are_of_characters_that_the_output_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """On Windows, a file of `bc-index > FILE` is in cp1252, which has no blocks."""
    stdout = io.TextIOWrapper(io.BytesIO(), "cp1252")
    monkeypatch.setattr(sys, "stdout", stdout)
    print_table(balance_table(Balance(np.array([1, 80, 1]), np.array([1, 40, 1]), 3, {})))
    stdout.seek(0)
    bars = [line.split("|")[3].strip() for line in stdout.read().splitlines() if line.startswith("| 0.")]
    assert bars == ["#" * 13, "#"]
