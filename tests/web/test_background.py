"""What is read of files while pages show what is there: what a store did not answer is told, and asked again."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from common.errors import StoreError
from tests.helpers.waiting import wait_until
from web.folders import background
from web.folders.background import Background

LOG = Path("a.mcap"), "of now"


def test_a_stores_slow_answer_is_named_before_it_is_asked_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Longer than until it would be asked again: that begins with the answer."""
    monkeypatch.setattr(background, "AGAIN_S", 0.5)
    asked = threading.Semaphore(0)

    def make(path: Path, version: str) -> str:
        asked.release()
        threading.Event().wait(0.6)
        raise StoreError(f"{path}: the store does not answer")

    with ThreadPoolExecutor(1) as pool:
        made = Background[Path, str](pool, make)
        (told,) = wait_until(lambda: made.results([LOG], 0)).values()
        assert str(told) == "a.mcap: the store does not answer"
        wait_until(lambda: not made.results([LOG], 0))
        assert asked.acquire()
        assert asked.acquire()
        made.results([], 0)
