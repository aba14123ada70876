"""The tables that bc-index prints."""

from __future__ import annotations

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
