"""`bc-record --driver`: who drove is in the log, and what people drive is recorded like any other session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dataset import IndexConfig, build_index
from recorder import Log
from recorder.cli import main as record_main
from udacity import call


def test_the_log_names_the_driver_and_is_indexed_whole(tmp_path: Path) -> None:
    arguments = ("--sessions", tmp_path, "--driver", "keyboard", "--laps", "0.008", "--recovery", "0")
    assert call(record_main, "mine", *arguments) == 0
    with Log(tmp_path / "mine.mcap") as log:
        assert (log.metadata["source"], log.metadata["driver"]) == ("simulator", "keyboard")
        steering = log.vehicle()["steering"].to_numpy()
    assert np.mean(steering == 0.0) > 0.3
    # takeovers are chosen by the commands of a drive: a session has none, and is taken whole
    index = build_index([tmp_path / "mine.mcap"], tmp_path / "index", IndexConfig(drives="takeovers"))
    assert index.frames.num_rows == 3 * len(steering)
    assert index.counts["mine"].not_taken_over == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--from", "recording", "--driver", "keyboard"), "--from and --listen record other drives"),
        (("--listen", "--driver", "mouse"), "--from and --listen record other drives"),
        (("--driver", "wheel"), "wheel"),
    ],
)
def test_a_driver_that_cannot_be_is_a_mistake_in_the_command(
    arguments: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(record_main, "x", "--sessions", tmp_path, *arguments) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
