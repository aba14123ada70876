"""Conditions on rows: one small language for `bc-log tag`, `bc-index` and `bc-web`, which runs nothing."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from common.errors import UsageError
from recorder.rows.condition import log_columns, rows_where
from recorder.rows.row_quality import States

ROWS = pa.table(
    {
        "row": range(5),
        "time_ns": [2**60 + row for row in range(5)],
        "steering": [-0.5, -0.1, 0.0, 0.1, 0.5],
        "speed_mph": [0.0, 1.0, 2.0, np.nan, 1e3],
        "session": pa.array(["lake", "lake", "lake2", "it's", "A = B"]).dictionary_encode(),
        "tags": [[], ["fog"], ["rain and fog", "fog"], ["it's"], []],
    }
)


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("speed_mph < 2", [0, 1]),
        ("2 > speed_mph", [0, 1]),
        ("speed_mph != 2", [0, 1, 4]),
        ("row <> 2", [0, 1, 3, 4]),
        ("steering >= -.1 and steering <= 1e-1", [1, 2, 3]),
        ("-steering > 0", [0, 1]),
        ("steering < -0.2 or row == 4", [0, 4]),
        ("row = 0 or row = 1 and row = 2", [0]),
        ("(row = 0 OR row = 1) AND Not steering=-0.5", [1]),
        ("0 < row <= 2", [1, 2]),
        ("row * 2 + 1 = 5 or row / 2 - 1 = 1", [2, 4]),
        ("row % 2 = 1", [1, 3]),
        ("abs(steering) > 0.2", [0, 4]),
        ("min(row, 2) = 2 and max(row, 3, speed_mph) = 3", [2]),
        ("time_ns = 1152921504606846977", [1]),
        ("row < 99999999999999999999", [0, 1, 2, 3, 4]),
        ("row<1or row>3", [0, 4]),
        ("2 > 1", [0, 1, 2, 3, 4]),
    ],
)
def test_numbers(condition: str, expected: list[int]) -> None:
    assert np.flatnonzero(rows_where(ROWS, condition)).tolist() == expected


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("not speed_mph > 1", [0, 1]),
        ("not (speed_mph > 1 and row = 3)", [0, 1, 2, 4]),
        ("speed_mph > 1 or row = 3", [2, 3, 4]),
        ("speed_mph + 1 > 0", [0, 1, 2, 4]),
        ("max(speed_mph, 5) = 5", [0, 1, 2]),
        ("speed_mph not in (1, 2)", [0, 4]),
        ("speed_mph is null", [3]),
        ("speed_mph IS NOT NULL", [0, 1, 2, 4]),
        ("0 / row = 0", [1, 2, 3, 4]),
    ],
)
def test_no_comparison_with_an_unknown_number_holds_nor_does_its_opposite(
    condition: str, expected: list[int]
) -> None:
    assert np.flatnonzero(rows_where(ROWS, condition)).tolist() == expected


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("session = 'lake'", [0, 1]),
        ("session in ('lake', 'A = B')", [0, 1, 4]),
        ("session not in ('lake')", [2, 3, 4]),
        ("'lake' in session", [0, 1, 2]),
        ("row in (1, 3)", [1, 3]),
        ("'fog' in tags", [1, 2]),
        ("'rain and fog' in tags", [2]),
        ("""'it''s' in tags and session = "it's" """, [3]),
        ("'fog' not in tags and len(tags) = 0", [0, 4]),
        (r"session = '\x6c'", []),
    ],
)
def test_texts_and_lists(condition: str, expected: list[int]) -> None:
    assert np.flatnonzero(rows_where(ROWS, condition)).tolist() == expected


def test_a_list_is_found_in_any_piece_of_a_table() -> None:
    pieces = pa.concat_tables([ROWS, ROWS.slice(1, 2), ROWS.slice(0, 0), ROWS.slice(2)])
    assert np.flatnonzero(rows_where(pieces, "'fog' in tags and row > 1")).tolist() == [2, 6, 7]
    assert not rows_where(ROWS.slice(0, 0), "'fog' in tags").any()


def test_the_columns_of_a_log() -> None:
    zeros = np.zeros(3)
    states = States(np.arange(3), np.array([5, 6, 7]) * 10**9, zeros, zeros, zeros, zeros)
    assert rows_where(log_columns(states), "time_s >= 1 and brake = throttle").tolist() == [False, True, True]


@pytest.mark.parametrize(
    "condition",
    ["", "row", "row <", "row < 2 and", "row < 2 2", "(row < 2", "row < 2)", "__import__('os')", "row;1",
     "row < ²", "row < .", "row < nan", "row = 1e", "row = null", "null", "row is 1", "row in ()",
     "row in (row, 1)", "'x' in row", "tags = 'fog'", "row < 'x'", "session < 1", "session and row = 1",
     "not row", "-session = 1", "abs(row, 1) = 1", "abs(x=row) = 1", "min(row) = 1", "row.real < 1",
     "row[0] < 1", "row < 2 # 3", "row < 2 -- two", "f'{row}' = 'x'", "1=1) union all select 1 from (select 1",
     "row = 1; drop table frames", "(lambda: row)() = 1", "'fog", "@ < 1", "row if row else row",
     "[row for row in tags] = 1", "(row := 1) = 1", "row = 1, row = 2", "*row = 1",
     "session in ('lake' 'lake2')", "'la' 'ke' = session", "session = '\udcff'", "'\udcff' in tags",
     "speed_mph > 5 is null", "'fog' in tags is null", "row = 1 in (1, 2)", "row in (1, null)",
     "'lake' in 'lake'"],
)  # fmt: skip
def test_anything_else_is_a_mistake_that_names_the_columns(condition: str) -> None:
    with pytest.raises(UsageError, match=r"^--where .*columns are row, time_ns, steering, .*, tags$"):
        rows_where(ROWS, condition)


@pytest.mark.parametrize(
    ("values", "condition", "named"),
    [
        (pa.array([1], pa.timestamp("ns")), "x > 5", "timestamp"),
        (pa.array([{"a": 1}]), "abs(x) > 5", "struct"),
        (pa.array([[1]]), "len(x) = 1 and 'fog' in x", "list<"),
    ],
)
def test_a_column_of_another_type_is_named(values: pa.Array, condition: str, named: str) -> None:
    with pytest.raises(UsageError, match=f": expected .*, not .*{named}"):
        rows_where(pa.table({"x": values}), condition)


@pytest.mark.parametrize(
    ("condition", "hint"),
    [
        ("speed < 2", r"no column speed \(did you mean speed_mph\?\)"),
        ("row between 5 and 9", "between is not known; write 5 <= row <= 9"),
        ("session LIKE 'lake%'", "like is not known; write 'lake' in session"),
        ("list_contains(tags, 'fog')", "list_contains is not known; write 'recovery' in tags"),
        ("speed_mph = null", "null stands only in is null and is not null"),
        ("""\"session\" = 'lake'""", "expected a column, not the text 'session'; columns have no quotes"),
        ('"speed_mph" is not null', "expected a column, not the text 'speed_mph'; columns have no quotes"),
        ("not row = 1 is null", "expected parentheses around one of the comparisons in row == 1 is None"),
        (
            "session = 'lake",
            r"unexpected \"'\"; expected comparisons such as speed_mph > 5, joined by and, or, not;",
        ),
        ("speed_mph > 5 and not isnan(speed_mph)", "isnan is not known; write speed_mph is null"),
    ],
)
def test_the_line_reports_what_to_write(condition: str, hint: str) -> None:
    with pytest.raises(UsageError, match=hint):
        rows_where(ROWS, condition)
