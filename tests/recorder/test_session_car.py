"""The car of a session: told by `--car`, kept in the log, read back; what nobody tells is as Udacity's."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from recorder import Log, LogWriter
from recorder.import_cli import main as bc_import
from recorder.log.session_car import BUILT_IN, CAR_KEY, Car, max_steering_deg_of, named_car, stored_car
from recorder.log_cli import main as bc_log
from recorder.server.telemetry import TelemetryError, parse_telemetry
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.settings import SimulatedDrive
from tests.helpers.driving import one_line_in
from tests.helpers.logs import write_log
from tests.helpers.serving import fields
from tests.helpers.udacity import call, jpeg, paths

OWN = """\
max_steering_deg = 30
wheelbase_m = 2.4
speed_unit = "m/s"
"""


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.toml").write_text(OWN)


def recording() -> Path:
    """Of one row, at a speed of 5."""
    folder = Path("driven")
    (folder / "IMG").mkdir(parents=True)
    for name in paths(1).split(","):
        (folder / name).write_bytes(jpeg(100))
    (folder / "driving_log.csv").write_text(f"{paths(1)},0.5,0.2,0,5\n")
    return folder


def test_a_car_that_is_reported_is_kept_and_read_back() -> None:
    assert call(bc_import, recording(), "own", "--car", "own.toml") == 0
    with Log("sessions/own.mcap") as log:
        assert stored_car(log) == Car(max_steering_deg=30, wheelbase_m=2.4, speed_unit="m/s")
        assert log.vehicle()["steering"].to_pylist() == [0.5]
        assert log.vehicle()["speed_mph"].to_pylist() == [pytest.approx(5 * 3600 / 1609.344)]
        assert max_steering_deg_of(log) == 30


def test_what_earlier_versions_knew_of_cameras_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    earlier = "lag_s = 0.1\nhorizon = 0.4\nleft_m = { left = 0.5 }\nbonnet = { center = [[0, 150], [320, 150]] }\n"
    Path("own.toml").write_text(OWN + earlier)
    assert call(bc_import, recording(), "own", "--car", "own.toml") == 0
    assert capsys.readouterr().err.splitlines()[-1] == "next: `bc-index`"
    with Log("sessions/own.mcap") as log:
        assert json.loads(log.metadata[CAR_KEY]) == tomllib.loads(OWN)
    with LogWriter(Path("earlier.mcap"), {"source": "udacity", CAR_KEY: json.dumps(tomllib.loads(OWN + earlier))}):
        pass
    with Log("earlier.mcap") as log:
        assert stored_car(log) == named_car("own.toml")


def test_a_log_that_shows_none_is_of_udacitys() -> None:
    assert call(bc_import, recording(), "plain") == 0
    with Log("sessions/plain.mcap") as log:
        assert CAR_KEY not in log.metadata
        assert max_steering_deg_of(log) == 25
        assert log.vehicle()["speed_mph"].to_pylist() == [5.0]


def test_the_built_in_simulators_sessions_show_its_own(tmp_path: Path) -> None:
    record_simulated(SimulatedDrive(laps=0.001), tmp_path / "lake.mcap")
    with Log(tmp_path / "lake.mcap") as log:
        assert stored_car(log) == BUILT_IN == Car(max_steering_deg=25, wheelbase_m=2.6, speed_unit="mph")


def test_live_telemetry_is_in_the_degrees_and_the_unit_of_its_car() -> None:
    reported = fields(0) | {"steering_angle": "-15.0000", "speed": "10.0000"}
    assert parse_telemetry(reported).steering == -15 / 25
    own = parse_telemetry(reported, car=Car(max_steering_deg=30, speed_unit="km/h"))
    assert own.steering == -0.5
    assert own.speed_mph == pytest.approx(10 / 1.609344)
    with pytest.raises(TelemetryError) as lost:  # what can be used of it is in mph, too
        parse_telemetry(reported | {"image": None}, car=Car(speed_unit="m/s"))
    assert lost.value.speed_mph == pytest.approx(22.369363)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ("wheels = 4", "unknown settings: wheels"),
        ('wheelbase_m = "long"', "$.wheelbase_m"),
        ("wheelbase_m = 0", "wheelbase_m 0: expected 0.01 to 100"),
        ("max_steering_deg = 90", "max_steering_deg 90"),
        ("wheelbase_m = nan", "wheelbase_m nan"),
        ('speed_unit = "knots"', "knots"),
        ("wheelbase_m 2.4", "line 1"),
        ("\udcff", "own.toml"),
        (f"wheelbase_m = {'[' * 10_000}", "own.toml"),
    ],
)
def test_a_file_with_other_settings_is_refused_in_one_line(
    settings: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("own.toml").write_bytes(settings.encode(errors="surrogateescape"))
    assert call(bc_import, recording(), "own", "--car", "own.toml") == 1
    assert expected in one_line_in(capsys)
    assert not Path("sessions").exists()


def test_sessions_of_other_steering_are_not_merged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_import, recording(), "own", "--car", "own.toml") == 0
    other = write_log(tmp_path / "other.mcap", [0.1], source="udacity")
    capsys.readouterr()
    assert call(bc_log, "merge", "sessions/own.mcap", other, "--to", "both.mcap") == 1
    assert "steering 1 is 25 degrees in it, and 30 in sessions/own.mcap" in one_line_in(capsys)
    assert not Path("both.mcap").exists()


def test_a_merged_log_has_the_car_of_its_sessions_if_they_have_one(tmp_path: Path) -> None:
    for name, wheelbase_m in (("a", 2.4), ("b", 2.4), ("c", 2.0)):
        about = {"source": "mcap", CAR_KEY: json.dumps({"wheelbase_m": wheelbase_m, "max_steering_deg": 30.0})}
        with LogWriter(tmp_path / f"{name}.mcap", about):
            pass
    assert call(bc_log, "merge", "a.mcap", "b.mcap", "--to", "ab.mcap") == 0
    assert call(bc_log, "merge", "b.mcap", "c.mcap", "--to", "bc.mcap") == 0
    with Log("ab.mcap") as log:
        assert stored_car(log) == Car(max_steering_deg=30, wheelbase_m=2.4)
    with Log("bc.mcap") as log:
        assert max_steering_deg_of(log) == 30
        assert stored_car(log) is None
