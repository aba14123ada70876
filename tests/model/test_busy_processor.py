"""Threads that wait for a processor, and so for one another, are noticed and said once."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from model import train
from model.training.busy_processor import busy_notice
from toy import SMALL, toy_index


def test_a_step_much_slower_than_it_computes_is_noticed() -> None:
    assert busy_notice(threads=2, wall_s=10.0, cpu_s=9.0) == ""
    said = busy_notice(threads=2, wall_s=10.0, cpu_s=4.0)
    assert "takes 2.5 times as long as it computes, and 2 threads wait for one another" in said
    assert "--threads 1 may be faster" in said
    assert "--threads 8 may be faster" in busy_notice(threads=16, wall_s=10.0, cpu_s=4.0)


def test_one_thread_waits_for_none_and_nothing_better_is_known() -> None:
    assert busy_notice(threads=1, wall_s=10.0, cpu_s=1.0) == ""


def test_a_clock_that_is_too_coarse_for_a_step_breaks_nothing() -> None:
    assert busy_notice(threads=4, wall_s=0.0, cpu_s=0.0) == ""
    assert "many times" in busy_notice(threads=4, wall_s=0.01, cpu_s=0.0)


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return toy_index(tmp_path_factory.mktemp("toy"))


@pytest.mark.parametrize(("threads", "computes", "times"), [(2, False, 1), (2, True, 0), (1, False, 0)])
def test_a_training_says_it_once(
    index: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    threads: int,
    computes: bool,
    times: int,
) -> None:
    """With a thread that never, or always, gets a processor, whatever goes on beside these tests."""
    monkeypatch.setattr(time, "thread_time", lambda: 10 * time.perf_counter() if computes else 0.0)
    before = torch.get_num_threads()
    try:
        config = replace(SMALL, epochs=2, batch=26, threads=threads)
        train(index, tmp_path / "run", config, show_progress=False)
    finally:
        torch.set_num_threads(before)
    assert [record.getMessage().startswith("the processor is busy") for record in caplog.records] == [True] * times
