"""The next step after a file that could not be written: making room does not help everybody."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from model.errors import RunWriteError
from model.runs.run_files import run_write_errors


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "make room"),
        (errno.EROFS, "choose a folder that you may write to"),
        (errno.EISDIR, "check the folder"),
    ],
)
def test_a_run_that_cannot_be_written_names_the_cause_and_its_remedy(number: int, remedy: str) -> None:
    with pytest.raises(RunWriteError) as raised, run_write_errors(Path("runs/a")):
        raise OSError(number, os.strerror(number))
    assert str(raised.value) == f"runs/a: cannot be written ({os.strerror(number)}); {remedy}"
