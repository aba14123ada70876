"""The lag of a log's steering: measured when somebody first needs it, and kept beside the log."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from dataset import build_index
from recorder import Log
from recorder.bc_pb2 import VehicleState
from recorder.log import known_lag as steering_lag
from recorder.log.findings import Findings
from recorder.log_cli import main
from recorder.rows.label_plan import NOT_MEASURED
from recorder.rows.row_quality import States
from recorder.rows.steering_habits import SteeringLag
from recorder.upkeep.edit import rewrite, trim
from recorder.upkeep.log_info import LogInfo, describe
from tests.helpers.panorama import pressed, views, write_drive
from tests.helpers.places import Place
from tests.helpers.udacity import call

ROWS = 1300
LATE_S = 0.3


def late(at_s: np.ndarray, late_s: float = LATE_S) -> np.ndarray:
    return pressed(at_s - late_s)


def half_late(at_s: np.ndarray) -> np.ndarray:
    """In time for 65 s, and late from then on."""
    return np.asarray(np.where(at_s < 65, pressed(at_s), late(at_s)))


def measured(path: Path) -> SteeringLag | None:
    with Log(path) as log:
        return steering_lag.measure_lag(log, States.of(log.vehicle()))


def lag_s(info: LogInfo) -> float:
    assert info.lag is not None
    return info.lag.lag_s


@pytest.fixture(scope="module")
def late_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("late") / "a.mcap", views(ROWS), late)


@pytest.fixture
def unmeasured(tmp_path: Path, late_drive: Path) -> Path:
    return Path(shutil.copy(late_drive, tmp_path))


def test_a_lag_that_an_earlier_version_noted_in_the_log_counts(
    unmeasured: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = measured(unmeasured)
    assert expected is not None
    note = {"lag": json.dumps(vars(expected))}
    as_metadata = Findings.as_metadata
    monkeypatch.setattr(Findings, "as_metadata", lambda self: as_metadata(self) | note)
    rewrite(unmeasured, unmeasured.with_name("earlier.mcap"))
    info = describe(unmeasured.with_name("earlier.mcap"))
    assert (info.lag, info.lacks_lag) == (expected, False)
    assert "0.4 s late" in info.labels


def test_a_session_that_shows_no_lag_is_not_looked_at_again(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "a.mcap", [b"no picture"] * ROWS, pressed)
    describe(path, look=True)
    info = describe(path)
    assert (info.lag, info.lacks_lag) == (None, False)
    assert "not measured" not in info.labels


def test_a_check_does_not_take_an_unknown_lag_for_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call(main, "check", write_drive(tmp_path / "a.mcap", views(1) * ROWS, pressed))
    assert "  its pictures do not show the lag\n" in capsys.readouterr().out


def test_nothing_is_measured_where_labels_do_not_depend_on_it(tmp_path: Path) -> None:
    paths = [
        write_drive(tmp_path / "expert.mcap", views(ROWS), driver="expert"),
        write_drive(tmp_path / "short.mcap", views(ROWS)[:300], pressed),
        write_drive(tmp_path / "device.mcap", views(ROWS), pressed, device=VehicleState.KEYBOARD),
    ]
    assert not any(describe(path).lacks_lag for path in paths)


def test_an_index_is_built_though_its_pictures_cannot_be_looked_at(
    unmeasured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        cv2.resize(np.empty((0, 0)), (1, 1))

    monkeypatch.setattr(steering_lag, "measure_lag", fails)
    indexed = build_index([unmeasured], tmp_path / "index")
    assert indexed.labels["a"].plan.why == NOT_MEASURED
    assert describe(unmeasured).lacks_lag


def test_a_log_of_before_is_measured_by_a_check_once(
    place: Place, unmeasured: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log = place(unmeasured)
    assert call(main, "info", log) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"(lag not measured); `bc-log check {log}` measures it" in shown
    assert call(main, "check", "--no-look", log) == 0
    assert not unmeasured.with_name("a.lag.json").exists()
    assert call(main, "check", log) == 0
    assert "  lag +0.30 ±0.05 s" in capsys.readouterr().out
    assert lag_s(describe(log)) == pytest.approx(LATE_S, abs=0.051)
    monkeypatch.setattr(steering_lag, "measure_lag", None)
    assert call(main, "check", log, "--json") == 0
    assert json.loads(capsys.readouterr().out)["lag"]["lag_s"] == pytest.approx(LATE_S, abs=0.051)
    assert call(main, "info", log) == 0
    assert "is 0.4 s late" in " ".join(capsys.readouterr().out.split())


def test_what_is_kept_is_for_one_content_and_may_be_damaged(tmp_path: Path, unmeasured: Path) -> None:
    describe(unmeasured, look=True)
    kept = tmp_path / "a.lag.json"
    good = json.loads(kept.read_text())
    others = (json.dumps(good | {"log": "another"}), json.dumps(good | {"lag": 3}))
    for bad in ("{", "[" * 9999, " " * 99999, *others):
        kept.write_text(bad)
        assert describe(unmeasured).lacks_lag
    kept.unlink()
    kept.symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").write_text(json.dumps(good))
    assert describe(unmeasured).lacks_lag


def test_a_derived_log_has_the_lag_of_its_own_rows(tmp_path: Path) -> None:
    whole = write_drive(tmp_path / "whole.mcap", views(ROWS), half_late)
    describe(whole, look=True)
    parts = [tmp_path / "first.mcap", tmp_path / "last.mcap"]
    trim(whole, parts[0], (0, 640))
    trim(whole, parts[1], (655, ROWS - 1))
    assert [lag_s(describe(part, look=True)) for part in parts] == pytest.approx([0, LATE_S], abs=0.051)


def test_an_unfinished_log_keeps_no_lag(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "a.mcap", views(ROWS), late, live=True)
    killed = tmp_path / "a.mcap.0a1b2c.part"
    killed.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    assert describe(killed).lacks_lag
    assert call(main, "check", killed) == 3
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".lag.json")]
