"""Flags of version 0.3 that have become verbs are understood, and the line as it is typed now is printed."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.verbs import in_verbs
from drive.evaluation.eval_flags import EARLIER as OF_EVAL
from model.train_flags import EARLIER as OF_TRAIN
from recorder.cli import EARLIER as OF_RECORD
from recorder.cli import main as bc_record
from tests.helpers.udacity import call


@pytest.mark.parametrize(
    ("earlier", "now"),
    [
        ("mine --driver me --track lake --open", "me mine --track lake --open"),
        ("--driver=me mine", "me mine"),
        ("live --listen --viewer", "listen live --viewer"),
        ("live --driver me --listen", "listen live --me"),
        ("race --gym CarRacing-v3 --expert a.py:drive", "gym CarRacing-v3 race --expert a.py:drive"),
        ("lake --driver keyboard", "lake --driver keyboard"),
        ("session", "session"),
    ],
)
def test_a_line_of_version_0_3_is_typed_with_a_verb_now(earlier: str, now: str) -> None:
    assert in_verbs(earlier.split(), OF_RECORD) == now.split()


@pytest.mark.parametrize(
    ("earlier", "now"),
    [
        ("--resume first --epochs 20", "resume first --epochs 20"),
        ("--name next --init=first --takeovers a.mcap", "continue first --name next --takeovers a.mcap"),
        ("--name first --epochs 2", "--name first --epochs 2"),
    ],
)
def test_a_training_of_version_0_3_is_typed_with_a_verb_now(earlier: str, now: str) -> None:
    assert in_verbs(earlier.split(), OF_TRAIN) == now.split()


@pytest.mark.parametrize(
    ("earlier", "now"),
    [
        ("first --simulator lake mountain --laps 2", "drive first --tracks lake mountain --laps 2"),
        ("--compare a b --gate", "compare a b --gate"),
        ("--compare a b --simulator lake", "compare a b --tracks lake"),
        ("first --bins", "first --bins"),
    ],
)
def test_an_evaluation_of_version_0_3_is_typed_with_a_verb_now(earlier: str, now: str) -> None:
    assert in_verbs(earlier.split(), OF_EVAL) == now.split()


def test_an_earlier_line_still_works_and_names_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(bc_record, "live", "--listen", "--port", 99999) == 2
    assert capsys.readouterr().err.splitlines() == [
        "bc-record: this is now `bc-record listen live --port 99999`",
        "bc-record listen: --port 99999: a port is a number from 1 to 65535",
    ]
