"""`bc-drive --gym`: a network drives a Gymnasium environment, and its drive is a log like any other."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drive.cli import main as bc_drive
from recorder.bc_pb2 import PilotCommand
from recorder.log.reader import Log
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import one_line_in, untrained_run
from tests.helpers.repository import ROOT
from tests.helpers.toy_environment import STEPS, bar, with_bars
from tests.helpers.udacity import call

UNSEEN = ("--viewer", "off")
SPEED = {"speed": "2.237*speed"}
SHORT = {"max_episode_steps": 5}


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """With a run that has learnt nothing."""
    monkeypatch.chdir(tmp_path)
    untrained_run(tmp_path / "runs" / "first")
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def commands(log: str) -> list[PilotCommand]:
    with Log(log) as opened:
        return [command for _, command in opened.commands()]


def test_it_drives_episodes_and_logs_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_drive, "first", *bar(**SPEED), *UNSEEN, "--episodes", 2, "--seed", 3, "--log", "d.mcap") == 0
    printed = capsys.readouterr().out
    assert "seed 3: 30 steps, reward" in printed
    assert "seed 4: 30 steps, reward" in printed
    assert "8.9 mph on average" in printed  # 4 m/s
    sent = [command.steering for command in commands("d.mcap")]
    with Log("d.mcap") as log:
        driven = log.vehicle()["steering"].to_pylist()
        episodes = json.loads(log.read_metadata("bc.gymnasium")["episodes"])
        assert log.metadata["simulator"] == "tests.helpers.toy_environment:toy/Bar-v0"
        events = Counter(event.message for _, event in log.decoded("/events"))
    assert len(sent) == 2 * STEPS
    assert events["pictures of 64x48 pixels, not 320x160: used nevertheless"] == 2  # once an episode
    # What was sent is what the environment's car did when the next picture was taken.
    for start in (0, STEPS):
        assert driven[start] == 0.0
        np.testing.assert_allclose(driven[start + 1 : start + STEPS], sent[start : start + STEPS - 1])
    assert [(episode["seed"], episode["steps"], episode["end"]) for episode in episodes] == [
        (3, STEPS, "truncated"),
        (4, STEPS, "truncated"),
    ]


def test_a_full_disk_ends_the_drive_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    line = [*bar(**SPEED), *UNSEEN, "--episodes", 40, "--log", "d.mcap"]
    with files_of_at_most(60_000):
        assert call(bc_drive, "first", *line) == 1
    shown = capsys.readouterr()
    assert "cannot be written any further (File too large)" in shown.err
    assert shown.out.count("seed") < 40


def test_an_expert_works_the_pedals_where_no_speed_is_reported() -> None:
    line = [*bar(args=SHORT), *UNSEEN, "--expert", "tests.helpers.toy_environment:centre", "--log", "d.mcap"]
    assert call(bc_drive, "first", *line) == 0
    sent = commands("d.mcap")
    assert {command.throttle for command in sent} == {0.25}
    assert any(command.steering != command.expert_steering for command in sent)


@pytest.mark.needs("box2d")
def test_a_network_drives_car_racing(capsys: pytest.CaptureFixture[str]) -> None:
    settings = Path("car.toml")
    settings.write_text(
        'id = "CarRacing-v3"\naction = "steering,throttle,brake"\nargs = {max_episode_steps = 20}\n'
    )
    expert = f"{ROOT / 'examples' / 'car_racing_expert.py'}:drive"
    line = ["first", "--gym", settings, "--expert", expert, *UNSEEN, "--log", "d.mcap"]
    assert call(bc_drive, *line) == 0
    assert "seed 0: 20 steps, reward" in capsys.readouterr().out
    assert len(commands("d.mcap")) == 20


@pytest.mark.parametrize("line", [["first"], ["--log", "d.mcap"]])
def test_the_earlier_flags_name_their_successor(line: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_drive, *line, "--gym", "CarRacing-v3", "--gym-rate", "20") == 2
    assert "--gym-rate: was removed; name a file that has rate_hz: --gym FILE.toml" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        ([{}, *UNSEEN], 1, "for the pedals give the environment's key"),
        ([SPEED, *UNSEEN, "--simulator", "lake"], 2, "--simulator: not with --gym"),
        ([SPEED, *UNSEEN, "--takeover"], 2, "--takeover: not with --gym"),
        ([SPEED, *UNSEEN, "--open"], 2, "--open: not with --gym"),
        ([SPEED, *UNSEEN, "--seed", "-1"], 2, "--seed -1"),
        (["--seed", "1"], 2, "--seed: only with --gym ID"),
        ([SPEED | {"args": {"observation": "numbers"}}, *UNSEEN], 1, "no camera picture"),
    ],
)
def test_what_cannot_be_driven_is_said_in_one_line(
    arguments: list[Any], code: int, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(bc_drive, "first", *with_bars(arguments)) == code
    assert expected in one_line_in(capsys)
    assert not Path("drives").exists()
