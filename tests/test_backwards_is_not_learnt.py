"""The recording of a student who drove some of it backwards, as Udacity's simulator would have written it: it is
named at the import, and not learnt."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.car import CAMERAS
from dataset import IndexConfig, Samples, build_index
from dataset.cli import main as bc_index
from dataset.samples.samples_format import not_learnt_in
from recorder.import_cli import main as bc_import
from recorder.log_cli import main as bc_log
from simulator.driving.expert import Expert
from simulator.driving.simulation import Simulation
from simulator.protocol.udacity_writer import UdacityWriter
from tests.helpers.udacity import call

START_NS = 1_767_225_600 * 10**9
RATE_HZ = 10


def record_student(folder: Path) -> set[int]:
    """Three seconds forwards, a stop, four backwards, and away; the rows in which the car moved backwards. To
    render less, the side cameras show what the centre one does."""
    simulation = Simulation("lake")
    course = simulation.course
    expert = Expert(course.line, 15.0)
    backwards = set()
    with UdacityWriter(folder) as writer:
        for row in range(120):
            steering, throttle = expert.control(course)
            if 30 <= row < 80:
                throttle = -1.0
            if course.vehicle.speed_mph < -0.5:
                backwards.add(row)
            writer.row(
                START_NS + row * 10**9 // RATE_HZ,
                dict.fromkeys(CAMERAS, simulation.jpeg()),
                steering=steering,
                throttle=max(0.0, throttle),
                brake=max(0.0, -throttle),
                speed_mph=course.vehicle.speed_mph,
            )
            course.advance(steering, throttle, 1 / RATE_HZ)
        writer.finish()
    return backwards


def test_it_is_named_at_the_import_and_not_learnt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    backwards = record_student(tmp_path / "student")
    assert len(backwards) > 30
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    speeds = [line.rpartition(",")[2] for line in Path("student/driving_log.csv").read_text().splitlines()]
    assert min(map(float, speeds)) >= 0  # the simulator's have no sign
    assert call(bc_import, "student", "student") == 0
    printed = capsys.readouterr().err
    assert "odd: driving backwards: rows " in printed
    assert "`bc-log tag sessions/student.mcap exclude --odd` excludes all that is sure" in printed
    assert call(bc_log, "ls") == 0
    assert "backwards" in capsys.readouterr().out

    assert call(bc_index, "--validation-share", 0) == 0
    printed = capsys.readouterr().err
    assert "neither learnt nor held out: student (" in printed
    assert "of driving backwards" in printed
    assert not_learnt_in(Path("index")) == [
        line for line in printed.splitlines() if line.startswith("neither learnt")
    ]

    def learnt(index: str) -> set[int]:
        with Samples(Path(index)) as samples:
            return {row["row"] for row in samples.table.to_pylist() if row["split"] == "train"}

    assert not learnt("index") & backwards
    assert len(learnt("index")) > 20  # of the rest
    build_index(
        [Path("sessions/student.mcap")], Path("other"), IndexConfig(labels="as-recorded", validation_share=0)
    )
    assert learnt("other") & backwards
