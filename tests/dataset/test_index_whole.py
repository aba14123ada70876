"""An index holds what the readable logs give, whatever came before; and it changes whole, or not at all."""

from __future__ import annotations

import itertools
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dataset import DatasetError, build_index, find_logs
from dataset.cli import main
from recorder import Log, LogError
from recorder.upkeep.recover import recover
from tests.helpers.layouts import Layout, mixed, two_kinds
from tests.helpers.logs import write_log, write_session
from tests.helpers.udacity import call, jpeg

STEERING = [round(0.02 * (row % 40) - 0.4, 2) for row in range(40)]  # 4 s


def log_of(path: Path, content: str = "") -> Path:
    return write_session(path, STEERING, f"{content:.<9}")  # of the same sizes


def flip(log: Path, position: int) -> None:
    """One bit, as a failing disk has it; all else stays."""
    with log.open("rb+") as stream:
        stream.seek(position)
        (byte,) = stream.read(1)
        stream.seek(position)
        stream.write(bytes([byte ^ 1]))


def flip_a_row(log: Path, row: int = 20) -> None:
    with Log(log) as opened:
        position = opened.messages("/vehicle")[row].offset + 5
    flip(log, position)


def flip_a_picture(log: Path, row: int = 20) -> None:
    with Log(log) as opened:
        position = next(frame["offset"] for frame in opened.frames().to_pylist() if frame["row"] == row)
    flip(log, position)


def files_of(index: Path) -> dict[str, bytes]:
    """All that anybody reads of an index: not its lock, nor what it remembers of sizes and times."""
    return {
        file.relative_to(index).as_posix(): file.read_bytes()
        for file in sorted(index.rglob("*"))
        if file.is_file() and file.name not in (".lock", "state.json")
    }


def sessions_of(index: Path) -> tuple[set[str], set[str]]:
    """Those that the frames hold, read as pandas does, and those of the samples."""
    frames = index / "frames"
    held = set(pq.read_table(frames)["session"].to_pylist()) if any(frames.iterdir()) else set()
    return held, set(pq.read_table(index / "samples.parquet")["session"].to_pylist())


# Whatever came before


def good(log: Path) -> None:
    """It comes back as it was, or has never changed."""
    remove(log)
    log_of(log)


def replaced(log: Path) -> None:
    remove(log)
    log_of(log, content=f"{next(numbers)}")


def damaged(log: Path) -> None:
    good(log)
    flip_a_row(log)


def replaced_by_a_damaged_one(log: Path) -> None:
    replaced(log)
    flip_a_row(log)


def cut_off(log: Path) -> None:
    """Such a log is read as far as it goes."""
    good(log)
    os.truncate(log, log.stat().st_size - 50)


def no_log(log: Path) -> None:
    damaged(log)
    log.write_bytes(b"no log")


def unreadable(log: Path) -> None:
    """As a file that may not be read; the tests may run as somebody who may read all."""
    remove(log)
    log.mkdir(parents=True)


def a_link_to_nowhere(log: Path) -> None:
    unreadable(log)
    remove(log)
    log.symlink_to(log.with_name("nowhere"))


def with_damaged_tags(log: Path) -> None:
    good(log)
    log.with_name(f"{log.stem}.tags.jsonl").write_text("no tag\n")


def remove(log: Path) -> None:
    """It has vanished."""
    log.with_name(f"{log.stem}.tags.jsonl").unlink(missing_ok=True)
    if log.is_dir():
        log.rmdir()
    else:
        log.unlink(missing_ok=True)


CHANGES: list[Callable[[Path], None]] = [
    good,
    replaced,
    damaged,
    replaced_by_a_damaged_one,
    cut_off,
    no_log,
    unreadable,
    a_link_to_nowhere,
    with_damaged_tags,
    remove,
]
INDEXED = (good, replaced, cut_off)
numbers = itertools.count()


def change(log: Path, how: Callable[[Path], None]) -> None:
    before = (log.read_bytes(), log.stat().st_mtime_ns) if log.is_file() else (b"", 0)
    how(log)
    if log.is_file():  # every change has a time of its own, however coarse the clock of the file system is
        time_ns = before[1] if log.read_bytes() == before[0] else next(numbers) * 1_000_000_000
        os.utime(log, ns=(time_ns, time_ns))


@settings(max_examples=15)
@example([[damaged, good, good]])
@example([[good, good, good], [replaced_by_a_damaged_one, damaged, good], [good, good, good]])
@given(st.lists(st.lists(st.sampled_from(CHANGES), min_size=3, max_size=3), min_size=1, max_size=3))
def test_an_index_is_that_of_the_logs_that_can_be_read(
    tmp_path_factory: pytest.TempPathFactory, steps: list[list[Callable[[Path], None]]]
) -> None:
    """However logs came and went: the same files, byte for byte, as if these logs alone had ever been there."""
    folder = tmp_path_factory.mktemp("any")
    logs = [folder / "sessions" / f"{name}.mcap" for name in "abc"]
    for step in steps:
        for log, how in zip(logs, step, strict=True):
            change(log, how)
        readable = [log for log, how in zip(logs, step, strict=True) if how in INDEXED]
        logs_given = find_logs((), folder / "sessions") if any((folder / "sessions").glob("*.mcap")) else logs
        if not readable:
            before = files_of(folder / "index") if (folder / "index").exists() else {}
            with pytest.raises(LogError):
                build_index(logs_given, folder / "index", leave_out_unreadable=True)
            assert files_of(folder / "index") == before
            continue
        indexed = build_index(logs_given, folder / "index", leave_out_unreadable=True)
        assert indexed.sessions == [log.stem for log in readable]
        left_out = [notice for notice in indexed.notices if notice.endswith("left out")]
        assert len(left_out) == len(logs_given) - len(readable)
        fresh = build_index(readable, folder / "fresh").path
        assert files_of(folder / "index") == files_of(fresh)
        shutil.rmtree(fresh)
        again = build_index(logs_given, folder / "index", leave_out_unreadable=True)
        assert (again.read, again.sessions, again.notices) == ([], indexed.sessions, indexed.notices)


def test_what_breaks_a_log_that_nobody_named_breaks_no_other(
    cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sessions = cwd / "sessions"
    damaged(sessions / "flipped.mcap")
    unreadable(sessions / "folder.mcap")
    (sessions / "loop.mcap").symlink_to("loop.mcap")
    write_log(sessions / "lake.mcap", STEERING, lambda camera, row: jpeg(60 + row))
    shutil.copy(sessions / "lake.mcap", sessions / os.fsdecode(b"caf\xe9.mcap"))
    for flags in ([], ["--look"]):
        assert call(main, *flags) == 3
        printed = capsys.readouterr().err
        for named in ("flipped.mcap: damaged", "folder.mcap", "loop.mcap: cannot be opened", "needs a name"):
            assert named in printed
        assert printed.count("left out") == 4
        assert sessions_of(cwd / "index") == ({"lake"}, {"lake"})
    assert call(main, "flipped", "lake") == 1


@pytest.mark.parametrize("layout", [two_kinds, mixed])
def test_a_log_with_hidden_damage_is_left_out_where_it_is_met(tmp_path: Path, layout: Layout) -> None:
    """Both are read because a session may share a picture with another one."""
    logs = [layout(log_of(tmp_path / "a.mcap")), tmp_path / "b.mcap"]
    shutil.copy(logs[0], logs[1])
    with pytest.raises(DatasetError, match="the same picture in both"):
        build_index(logs, tmp_path / "index")
    build_index(logs[:1], tmp_path / "index")
    status = logs[0].stat()
    flip_a_picture(logs[0])
    os.utime(logs[0], ns=(status.st_atime_ns, status.st_mtime_ns))
    with pytest.raises(LogError, match=r"a\.mcap: damaged.*CRC"):
        build_index(logs, tmp_path / "index")
    indexed = build_index(logs, tmp_path / "index", leave_out_unreadable=True)
    assert indexed.sessions == ["b"]
    assert "a.mcap: damaged" in indexed.notices[0]
    assert build_index(logs, tmp_path / "index", leave_out_unreadable=True).sessions == ["b"]


# Whole, or not at all


class Moments:
    """Calls a function whenever a file is about to be opened, renamed, made or removed beneath a folder."""

    def __init__(self) -> None:
        self._at: tuple[Path, Callable[[], None]] | None = None
        sys.addaudithook(self._hear)  # there for good: it has to be quiet again

    def call_at_each(self, folder: Path, action: Callable[[], None]) -> None:
        self._at = folder, action

    def over(self) -> None:
        self._at = None

    def _hear(self, event: str, arguments: tuple[object, ...]) -> None:
        if self._at is None or event not in ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir"):
            return
        folder, action = self._at
        if str(arguments[0]).startswith(str(folder)):
            self._at = None
            action()
            self._at = folder, action


MOMENTS = Moments()


@pytest.fixture
def moments() -> Iterator[Moments]:
    yield MOMENTS
    MOMENTS.over()


def changed_sessions(tmp_path: Path) -> tuple[list[Path], Path, dict[str, bytes], dict[str, bytes]]:
    """Logs of which one stays, one was replaced, one has vanished and one is new; the index of before, its files,
    and those it is to have."""
    sessions = tmp_path / "sessions"
    before = build_index([log_of(sessions / f"{name}.mcap") for name in "abc"], tmp_path / "before").path
    logs = [sessions / "a.mcap", log_of(sessions / "b.mcap", "other"), log_of(sessions / "d.mcap")]
    after = build_index(logs, tmp_path / "after").path
    return logs, before, files_of(before), files_of(after)


def test_a_killed_build_leaves_whole_samples_and_the_next_one_ends_it(tmp_path: Path, moments: Moments) -> None:
    logs, before, old, new = changed_sessions(tmp_path)
    index = shutil.copytree(before, tmp_path / "index")
    left: list[Path] = []
    states: list[dict[Path, bytes | None]] = []

    def kill() -> None:
        """What somebody finds on the disk if the power fails now, unless it was found a moment before."""
        state = {path: path.read_bytes() if path.is_file() else None for path in index.rglob("*")}
        if state not in states:
            states.append(state)
            left.append(shutil.copytree(index, tmp_path / f"killed{len(left)}"))

    moments.call_at_each(index, kill)
    build_index(logs, index)
    moments.over()
    assert files_of(index) == new
    assert len(left) > 10
    for killed in left:
        assert (killed / "samples.parquet").read_bytes() in (old["samples.parquet"], new["samples.parquet"])
        build_index(logs, killed)
        assert files_of(killed) == new


def test_a_refused_build_leaves_nothing(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = log_of(cwd / "sessions" / "x.mcap")
    assert call(main, "--validation-share", 0) == 0
    old = files_of(cwd / "index")
    recover(log, cwd / "sessions" / "x.recovered.mcap")
    assert call(main, "--validation-share", 0) == 1
    assert "the same picture in both" in capsys.readouterr().err
    assert files_of(cwd / "index") == old
    assert call(main, "--validation-share", 0, "--index", "other") == 1
    assert not (cwd / "other").exists()


@pytest.mark.parametrize(
    ("flags", "printed"),
    [
        (["--where", "nonsense = 1"], "--where 'nonsense = 1'"),
        (["--validation", "nobody"], "--validation nobody: no such session"),
        (["--validation", "a", "--validation-share", "0"], "--validation-share: not with --validation"),
        (["--validation", "a", "--gap-s", "5"], "--gap-s: not with --validation"),
        (["--max-uses", "0"], "--max-uses 0: expected at least 1"),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_read(
    cwd: Path, capsys: pytest.CaptureFixture[str], flags: list[str], printed: str
) -> None:
    log_of(cwd / "sessions" / "a.mcap")
    assert call(main, "--look", *flags) == (1 if "nobody" in flags else 2)
    assert printed in capsys.readouterr().err
    assert not (cwd / "index").exists()
