"""`bc-web` serves folders: a file in the place of one is refused before anything listens."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.udacity import call
from web.cli import main


@pytest.mark.parametrize("flag", ["sessions", "drives"])
def test_a_file_is_no_folder(
    flag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plain").touch()
    assert call(main, f"--{flag}", "plain") == 1
    told = capsys.readouterr()
    assert (told.out, told.err) == ("", f"bc-web: --{flag} plain: expected a folder, but it is a file\n")
