"""Every command, as the README's line installs it."""

from __future__ import annotations

import re
import tomllib
from typing import Final

import pytest

import run_examples
from tests.helpers.installed_toolkit import Toolkit
from tests.helpers.lerobot_logs import write_drives
from tests.helpers.other_logs import CAMERA, WHEEL, angle, image, write_mcap
from tests.helpers.repository import ROOT
from tests.helpers.tubs import record_2, write_tub_2
from tests.helpers.udacity import jpeg

PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.mark.parametrize("command", PROJECT["scripts"])
def test_every_command_reports_what_it_does(made: Toolkit, command: str) -> None:
    assert made.do(command, "--help").startswith("usage: ")


ROOMS: Final = ("common", "simulator", "recorder", "dataset", "model", "viz", "drive", "web")


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_is_there_without_any_extra(made: Toolkit, room: str) -> None:
    code = f"import {room}\nfor name in dir({room}): getattr({room}, name)\n"
    made.do("python", "-c", code)


def test_a_run_is_evaluated_and_drives(made: Toolkit) -> None:
    assert "degrees" in made.do("bc-eval", "first")
    assert "lake" in made.do(
        "bc-eval", "drive", "first", "--tracks", "lake", "--laps", 0.02, "--drives", "evaluated"
    )
    assert "first" in made.do("bc-runs")
    assert "lake" in made.do("bc-log", "ls")
    made.do("bc-train", "resume", "first", "--epochs", 2)
    made.do("bc-train", "continue", "first", "--name", "more", "--network", "small", "--epochs", 1)
    assert made.run("bc-eval", "compare", "first", "more").code in (0, 3)  # 3: too few frames for a verdict
    assert made.run("bc-doctor").code in (0, 3)


def test_drives_are_shown(made: Toolkit) -> None:
    made.do("bc-play", "drives/run.mcap", "--save", "run.rrd")
    made.do("bc-play", "drives/run.mcap", "--run", "first", "--save", "with_first.rrd")
    made.do("bc-play", "drives/run.mcap", "--video", "run.mp4", "--overlay")
    assert (made.folder / "run.mp4").read_bytes()[4:8] == b"ftyp"


def test_logs_are_cleaned(made: Toolkit) -> None:
    log = "sessions/lake.mcap"
    for words in (("info",), ("check",), ("tag",)):
        made.run("bc-log", *words, log)
    made.do("bc-log", "tag", log, "slow", "--where", "speed_mph < 2 and throttle > 0", "--yes")
    made.do("bc-log", "tag", log, "fine", "--rows", 3, 9)
    made.do("bc-log", "trim", log, "--to", "cut/start.mcap", "--rows", 0, 20)
    made.do("bc-log", "merge", "cut/start.mcap", "sessions/mountain.mcap", "--to", "cut/both.mcap")
    made.do("bc-log", "split", "cut/both.mcap", "--to", "cut/drives")
    made.do("bc-log", "rewrite", log, "--to", "cut/new.mcap")
    assert "cp" in made.refused("bc-log", "copy", log, "copies/lake.mcap")
    whole = (made.folder / log).read_bytes()
    (made.folder / "cut" / "killed.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    assert made.run("bc-log", "recover", "cut/killed.mcap").code in (0, 3)


def test_an_index_is_chosen_checked_and_exported(made: Toolkit) -> None:
    where = "speed_mph > 5 and abs(steering) < 0.9"
    made.do("bc-index", "--index", "index-fast", "--where", where, "--block-s", 2, "--gap-s", 0, "--check")
    made.do("bc-index", "export", "--lerobot", "datasets/index", "--where", "abs(steering) < 0.5")


def test_every_kind_of_recording_is_imported(made: Toolkit) -> None:
    """Udacity's, a csv, a tub, another program's log, and LeRobot's with pictures and with videos."""
    to = ("--sessions", "imported")
    made.do("bc-import", "recording", "udacity", *to)
    folder = made.folder
    rows = (folder / "recording" / "driving_log.csv").read_text().splitlines()
    (folder / "csv").mkdir()
    lines = ["image,angle"]
    for number, row in enumerate(rows[:20]):
        center, *_ = row.split(",")
        name = re.split(r"[\\/]", center)[-1]
        (folder / "csv" / name).write_bytes((folder / "recording" / "IMG" / name).read_bytes())
        lines.append(f"{name},{number / 100}")
    (folder / "csv" / "data.csv").write_text("\n".join(lines))
    made.do("bc-import", "csv", "csv", "--columns", "image=image", "steering=angle", "--rate", 10, *to)
    made.do("bc-import", write_tub_2(folder / "tub", [record_2(n) for n in range(4)]), "tub", *to)
    pairs = [((WHEEL, n / 10, angle(n / 50)), (CAMERA, n / 10, image(jpeg(90, n)))) for n in range(9)]
    write_mcap(folder / "other.mcap", (message for pair in pairs for message in pair))
    topics = ("--image", CAMERA, "--steering", f"{WHEEL}.steering.angle")
    made.do("bc-import", "other.mcap", "other", *topics, *to)
    log = write_drives(folder / "lerobot.mcap")
    for kind in ((), ("--video",)):
        name = f"lerobot{len(kind)}"
        made.do("bc-log", "export", log, "--lerobot", f"datasets/{name}", *kind)
        made.do("bc-import", f"datasets/{name}", name, *to)


def test_gymnasium_is_there(made: Toolkit) -> None:
    code = "import gymnasium; gymnasium.make('simulator:bc/Lake-v0').reset(seed=1)"
    made.do("python", "-W", "error", "-c", code)
    (made.folder / "hold.py").write_text("def drive(environment, observation):\n    return [0.0, 0.5]\n")
    settings = 'id = "simulator:bc/Lake-v0"\naction = "steering,throttle"\nargs = {max_episode_steps = 20}\n'
    (made.folder / "lake.toml").write_text(settings)
    done = made.run("bc-record", "gym", "lake.toml", "gym", "--expert", "hold.py:drive", "--sessions", "imported")
    assert done.code == 0, done


def test_a_simulator_connects_from_another_process(made: Toolkit) -> None:
    with made.start("bc-drive", "first", "--log", "drives/connected.mcap", "--port", 0) as drive:
        assert drive.stderr is not None
        port = next(found[1] for line in drive.stderr if (found := re.search(r"127\.0\.0\.1:(\d+)", line)))
        made.do("bc-sim", "--port", port, "--laps", 0.02)
        drive.terminate()
        drive.communicate()
    assert "rows" in made.do("bc-log", "info", "drives/connected.mcap")


def test_the_readmes_python_runs_as_it_stands(made: Toolkit) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = run_examples.blocks(readme, "python")
    made.do("python", "-I", "-c", code.replace("epochs=1", 'epochs=1, network="small"'))
