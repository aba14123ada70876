"""Tags: names for stretches of a log, in a journal beside it that nothing damages for good."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder import LogError
from recorder.log.tags import Tag, add_tags, check_name, read_tags, remove_tags, tags_by_content, tags_path
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import PATIENCE_S, environment

CONTENT, OTHER_CONTENT = "a" * 64, "b" * 64


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Nothing reads the log itself: its fingerprint is given."""
    return tmp_path / "lake.mcap"


rows = st.tuples(st.integers(0, 5), st.integers(0, 2**32 - 1)).filter(lambda rows: rows[0] <= rows[1])
names = st.sampled_from(["exclude", "recovery", "Größe, «x» #1", "\u4e2d\u6587", 'quotes "\\'])
changes = st.tuples(st.sampled_from(["add", "remove"]), rows, names, st.sampled_from([CONTENT, OTHER_CONTENT]))


@given(changes=st.lists(changes, max_size=12))
def test_tags_are_what_was_added_and_not_removed_since(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[str, tuple[int, int], str, str]]
) -> None:
    """Of each content of the log on its own, whatever the order."""
    log = tmp_path_factory.mktemp("tags") / "lake.mcap"
    expected: dict[str, dict[tuple[int, int, str], bool]] = {CONTENT: {}, OTHER_CONTENT: {}}
    for action, (first, last), name, content in changes:
        tag = Tag(first, last, name)
        (add_tags if action == "add" else remove_tags)(log, content, [tag])
        expected[content][first, last, name] = action == "add"
    for content, model in expected.items():
        read = [(tag.first_row, tag.last_row, tag.name) for tag in read_tags(log, content)]
        assert read == sorted(key for key, is_there in model.items() if is_there)
        others = [other for fingerprint, other in expected.items() if fingerprint != content]
        assert sum(len(tags) for other, tags in tags_by_content(log).items() if other != content) == sum(
            sum(other.values()) for other in others
        )


def test_a_log_without_tags_has_none(log: Path) -> None:
    assert read_tags(log, CONTENT) == []
    remove_tags(log, CONTENT, [Tag(1, 2, "exclude")])
    assert read_tags(log, CONTENT) == []


def test_the_file_is_lines_of_json_beside_the_log(log: Path) -> None:
    add_tags(log, CONTENT, [Tag(3, 5, "exclude")])
    remove_tags(log, CONTENT, [Tag(3, 5, "exclude")])
    path = log.parent / "lake.tags.jsonl"
    assert [json.loads(line) for line in path.read_text().splitlines()] == [
        {"add": "exclude", "rows": [3, 5], "log": CONTENT},
        {"remove": "exclude", "rows": [3, 5], "log": CONTENT},
    ]


def test_wherever_a_crash_cuts_the_last_line_the_others_stay(log: Path) -> None:
    first, second, third = Tag(1, 2, "one"), Tag(3, 4, "two Größe"), Tag(5, 6, "three")
    add_tags(log, CONTENT, [first])
    begin = tags_path(log).stat().st_size
    add_tags(log, CONTENT, [second])
    whole = tags_path(log).read_bytes()
    for length in range(begin, len(whole) - 1):
        tags_path(log).write_bytes(whole[:length])
        assert read_tags(log, CONTENT) == [first]
        add_tags(log, CONTENT, [third])
        assert read_tags(log, CONTENT) == [first, third]


DAMAGED = {
    "no JSON": b"exclude 3 5",
    "neither added nor removed": b'{"rows": [1, 2], "log": "%s"}',
    "both": b'{"add": "x", "remove": "x", "rows": [1, 2], "log": "%s"}',
    "rows the wrong way round": b'{"add": "x", "rows": [2, 1], "log": "%s"}',
    "a row of many digits": b'{"add": "x", "rows": [1, ' + b"9" * 5000 + b'], "log": "%s"}',
    "a name with a terminal's control codes": b'{"add": "\\u001b[2J", "rows": [1, 2], "log": "%s"}',
    "nested without end": b"[" * 100_000,
}


@pytest.mark.parametrize("line", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_line_is_an_error_that_names_it_and_nothing_is_lost(log: Path, line: bytes) -> None:
    """Tags may keep rows out of training: to go on with half of them would be worse than to stop."""
    add_tags(log, CONTENT, [Tag(1, 2, "exclude")])
    with tags_path(log).open("ab") as stream:
        stream.write(line.replace(b"%s", CONTENT.encode()) + b"\n")
    before = tags_path(log).read_bytes()
    with pytest.raises(LogError, match=r"lake\.tags\.jsonl: line 2 is not a tag") as caught:
        read_tags(log, CONTENT)
    assert "\n" not in str(caught.value)
    add_tags(log, CONTENT, [Tag(3, 4, "exclude")])
    assert tags_path(log).read_bytes().startswith(before)


def test_an_endless_file_is_refused_without_reading_it(log: Path) -> None:
    tags_path(log).touch()
    os.truncate(tags_path(log), 1 << 40)
    with pytest.raises(LogError, match="larger than"):
        read_tags(log, CONTENT)
    with pytest.raises(LogError, match="larger than"):
        add_tags(log, CONTENT, [Tag(0, 1, "good")])
    assert tags_path(log).stat().st_size == 1 << 40


@pytest.mark.parametrize("name", ["", " ", "x" * 65, "two\nlines", "\x1b[2J", "\udce9", 5, None])
def test_names_that_no_tag_can_have(log: Path, name: object) -> None:
    with pytest.raises(ValueError, match="not a name for a tag"):
        check_name(name)
    with pytest.raises(LogError, match="not a name for a tag"):
        add_tags(log, CONTENT, [Tag(1, 2, name)])  # type: ignore[arg-type]
    assert not tags_path(log).exists()


@pytest.mark.parametrize("rows", [(2, 1), (-1, 1), (0, 2**32)])
def test_rows_that_no_tag_can_have(log: Path, rows: tuple[int, int]) -> None:
    """A line that cannot be read again would take all other tags with it."""
    with pytest.raises(LogError, match="row"):
        add_tags(log, CONTENT, [Tag(*rows, "exclude")])
    assert not tags_path(log).exists()


def test_tags_that_do_not_fit_on_the_disk_change_nothing(log: Path) -> None:
    tags = [Tag(row, row, "exclude") for row in range(3)]
    add_tags(log, CONTENT, tags)
    size = tags_path(log).stat().st_size
    tags_path(log).unlink()
    for limit in (0, 10, size - 1):
        with files_of_at_most(limit), pytest.raises(LogError, match=r"lake\.tags\.jsonl: cannot be written"):
            add_tags(log, CONTENT, tags)
        assert not tags_path(log).exists()
    add_tags(log, CONTENT, [Tag(9, 9, "kept")])
    before = tags_path(log).read_bytes()
    with files_of_at_most(len(before) + size - 1), pytest.raises(LogError, match="cannot be written"):
        add_tags(log, CONTENT, tags)
    assert tags_path(log).read_bytes() == before


ADD_MANY = """
import sys
from pathlib import Path
from recorder.log.tags import Tag, add_tags
log, content, number, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
print("ready", flush=True)
sys.stdin.readline()
for row in range(count):
    add_tags(log, content, [Tag(row, row, f"process {number}")])
"""


def test_processes_that_tag_at_once_lose_nothing(log: Path) -> None:
    count, processes = 20, 3
    started = [
        subprocess.Popen(
            [sys.executable, "-c", ADD_MANY, str(log), CONTENT, str(number), str(count)],
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for number in range(processes)
    ]
    try:
        for process in started:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
        for process in started:
            process.communicate(b"go\n", timeout=PATIENCE_S)
    finally:
        for process in started:
            process.kill()
            process.communicate()
    assert [process.returncode for process in started] == [0] * processes
    expected = [Tag(row, row, f"process {number}") for row in range(count) for number in range(processes)]
    assert read_tags(log, CONTENT) == sorted(expected)
