"""`bc-play LOG --run RUN`: what other networks would have steered, as Rerun's and mcap's own readers see it."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from common import UserError
from common.car import Camera
from dataset import decode
from drive.cli import main as drive_main
from model import RunError, load_pilot
from model.evaluation.predict_log import predict_log
from recorder import Log, LogWriter
from recorder.upkeep.check import check
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.logs import START_NS, STEP_NS, read_messages, write_log
from tests.helpers.rrd import contents, view_names
from tests.helpers.udacity import call
from viz.cli import main

ROWS = 70  # more than a batch
STEERING = [round(0.9 * np.sin(row / 9), 3) for row in range(ROWS)]
BROKEN = 12


def picture(camera: Camera, row: int) -> bytes:
    return road_jpeg(row)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """runs/first and runs/second, never trained, and a session."""
    folder = tmp_path_factory.mktemp("predictions")
    untrained_run(folder / "runs" / "first", seed=1)
    untrained_run(folder / "runs" / "second", seed=2)
    write_log(folder / "session.mcap", STEERING, picture)
    return folder


@pytest.fixture(autouse=True)
def _worked_in(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project)
    monkeypatch.setenv("COLUMNS", "400")


@pytest.fixture(scope="module")
def printed(project: Path) -> dict[str, list[float]]:
    """What each network says of each picture, asked as when it drives."""
    result = {}
    for name in ("first", "second"):
        pilot = load_pilot(project / "runs" / name, "float32")
        result[name] = [pilot.predict(pilot.crop(decode(road_jpeg(row)))) for row in range(ROWS)]
    return result


@pytest.fixture(scope="module")
def shown(project: Path) -> Path:
    flags = ("--run", "first", "--run", "second", "--runs", project / "runs", "--save", project / "session.rrd")
    with (project / "said.txt").open("w") as stream, contextlib.redirect_stdout(stream):
        assert call(main, project / "session.mcap", *flags) == 0
    return project / "session.rrd"


def values(rrd: Path, entity: str) -> list[float]:
    return [value[0] for value in contents(rrd)[entity]["Scalars:scalars"]]


def test_each_run_has_a_curve_beside_what_was_recorded(shown: Path, printed: dict[str, list[float]]) -> None:
    entities = contents(shown)
    assert values(shown, "/steering/recorded") == pytest.approx(STEERING)
    for name in ("first", "second"):
        entity = f"/steering/predicted_by/{name}"
        assert values(shown, entity) == pytest.approx(printed[name], abs=1e-4)
        assert entities[entity]["message_log_time"] == [START_NS + row * STEP_NS for row in range(ROWS)]
        assert entities[entity]["SeriesLines:names"] == [[name]]
    assert printed["first"] != pytest.approx(printed["second"], abs=0.01)


def test_the_errors_are_in_degrees_against_what_was_recorded(shown: Path, printed: dict[str, list[float]]) -> None:
    expected = [
        25 * (predicted - recorded) for predicted, recorded in zip(printed["second"], STEERING, strict=True)
    ]
    assert values(shown, "/error_deg/second") == pytest.approx(expected, abs=0.01)


def test_the_worst_moments_are_events_apart_in_time(shown: Path, printed: dict[str, list[float]]) -> None:
    error = 25 * np.abs(np.array(printed["first"]) - np.array(STEERING))
    worst: list[int] = []
    for row in np.argsort(-error).tolist():
        if all(abs(row - other) * STEP_NS >= 10**9 for other in worst) and len(worst) < 10:
            worst.append(row)
    events = contents(shown)["/events/worst/first"]
    assert events["message_log_time"] == [START_NS + row * STEP_NS for row in sorted(worst)]
    assert {level[0] for level in events["TextLog:level"]} == {"WARN"}
    for text, row in zip(events["TextLog:text"], sorted(worst), strict=True):
        assert f"first: {error[row]:.1f} degrees too far to the" in text[0]
        assert f"{25 * STEERING[row]:.1f} recorded (row {row})" in text[0]


def test_the_layout_shows_errors_and_attention_if_asked_for(shown: Path) -> None:
    plots = {"steering, -1 left .. 1 right", "error in degrees: predicted - recorded", "events"}
    assert plots <= view_names(shown)
    assert not [name for name in view_names(shown) if "looks" in name]
    assert not [entity for entity in contents(shown) if entity.startswith("/attention")]


def test_how_far_each_run_is_off_is_printed(project: Path, shown: Path, printed: dict[str, list[float]]) -> None:
    lines = (project / "said.txt").read_text().splitlines()
    error = 25 * (np.array(printed["first"]) - np.array(STEERING))
    rmse, mean = np.sqrt(np.mean(error**2)), 25 * np.std(STEERING)
    expected = (
        f"first: {ROWS} frames, RMSE {rmse:.2f} degrees from the recorded steering (always the mean: {mean:.2f})"
    )
    assert lines[0].startswith(expected)
    assert lines[1].startswith(f"second: {ROWS} frames")


def test_the_network_that_drove_reports_again_what_it_said_then(project: Path, tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    flags = ("--simulator", "lake", "--laps", 0.003, "--precision", "float32", "--log", log)
    assert call(drive_main, "first", *flags) == 0
    predictions = predict_log(log, [project / "runs" / "first"])
    commands = read_messages(log)["/pilot/command"]
    assert len(commands) > 20
    assert predictions.log_time_ns.tolist() == [message.log_time for message, _ in commands]
    assert predictions.row.tolist() == [message.sequence for message, _ in commands]
    logged = [command.predicted_steering for _, command in commands]
    np.testing.assert_allclose(predictions.predicted["first"], logged, atol=1e-5)
    states = [state.steering for _, state in read_messages(log)["/vehicle"]]
    np.testing.assert_allclose(predictions.recorded, states, atol=1e-9)


def test_their_steering_is_drawn_over_the_frame(shown: Path, printed: dict[str, list[float]]) -> None:
    """As an arc whose end is to the side by what is steered."""
    (first, second) = (contents(shown)[f"/camera/center/steering/predicted_by/{name}"] for name in printed)
    for arcs, name in ((first, "first"), (second, "second")):
        ends = [strips[0][-1][0] for strips in arcs["LineStrips2D:strips"]]
        assert ends == pytest.approx([160 + 144 * np.clip(value, -1, 1) for value in printed[name]], abs=0.1)
    assert first["LineStrips2D:colors"] != second["LineStrips2D:colors"]


# A log of their own


def test_they_are_kept_as_a_log_that_others_read_and_bc_play_shows(
    tmp_path: Path, printed: dict[str, list[float]], capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "kept.mcap"
    assert call(main, "session.mcap", "--run", "first", "--run", "second", "--write", kept) == 0
    assert f"{kept}: written" in capsys.readouterr().out
    messages = read_messages(kept)
    assert set(messages) == {"/prediction/first", "/prediction/second", "/events"}
    for name in ("first", "second"):
        predictions = messages[f"/prediction/{name}"]
        assert [message.log_time for message, _ in predictions] == [
            START_NS + row * STEP_NS for row in range(ROWS)
        ]
        assert [message.sequence for message, _ in predictions] == list(range(ROWS))
        assert [prediction.steering for _, prediction in predictions] == pytest.approx(printed[name], abs=1e-4)
        assert [prediction.recorded_steering for _, prediction in predictions] == STEERING
    assert len(messages["/events"]) == len({event.message for _, event in messages["/events"]}) > 10
    assert check(kept).findings == []

    assert call(main, kept, "--save", tmp_path / "kept.rrd") == 0
    assert values(tmp_path / "kept.rrd", "/steering/predicted_by/second") == pytest.approx(
        printed["second"], abs=1e-4
    )
    expected = [
        25 * (predicted - recorded) for predicted, recorded in zip(printed["first"], STEERING, strict=True)
    ]
    assert values(tmp_path / "kept.rrd", "/error_deg/first") == pytest.approx(expected, abs=0.01)
    assert "error in degrees: predicted - recorded" in view_names(tmp_path / "kept.rrd")


def test_it_reports_which_log_and_which_weights(project: Path, tmp_path: Path) -> None:
    assert call(main, "session.mcap", "--run", "first", "--write", tmp_path / "kept.mcap") == 0
    with Log(tmp_path / "kept.mcap") as kept, Log("session.mcap") as session:
        assert kept.metadata["source"] == "prediction"
        assert kept.metadata["log"] == "session.mcap"
        assert kept.metadata["log_fingerprint"] == session.fingerprint
        weights = load_pilot(project / "runs" / "first").weights_sha256
        assert kept.metadata["weights_sha256.first"] == weights


@pytest.mark.parametrize(
    ("flag", "name", "ending"),
    [
        ("--write", "said.rrd", ".mcap"),
        ("--save", "said", ".rrd"),
        ("--video", "said.avi", ".mp4"),
    ],
)
def test_a_file_is_called_what_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flag: str, name: str, ending: str
) -> None:
    assert call(main, "session.mcap", flag, tmp_path / name) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{flag} {tmp_path / name}: it writes an {ending} file" in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("flag", "name"), [("--write", "precious.mcap"), ("--save", "precious.rrd")])
def test_an_existing_file_is_kept_unless_it_is_forced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flag: str, name: str
) -> None:
    precious = tmp_path / name
    precious.write_bytes(b"precious")
    assert call(main, "session.mcap", "--run", "first", flag, precious) == 1
    assert "--force" in capsys.readouterr().err
    assert (precious.read_bytes(), list(tmp_path.iterdir())) == (b"precious", [precious])
    assert call(main, "session.mcap", "--run", "first", flag, precious, "--force") == 0
    assert precious.stat().st_size > 1000


@pytest.mark.parametrize("flags", [("--save",), ("--run", "first", "--save"), ("--run", "first", "--write")])
def test_a_log_is_never_written_over(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...]
) -> None:
    log = tmp_path / "session.mcap"
    log.write_bytes((project / "session.mcap").read_bytes())
    (tmp_path / "link").symlink_to(log)
    for name in ("session.mcap", "link"):
        assert call(main, log, *flags, tmp_path / name, "--force") == 1
        assert f"{flags[-1]} {tmp_path / name}: is the log itself" in capsys.readouterr().err
    assert log.read_bytes() == (project / "session.mcap").read_bytes()


# Logs that are not as they should be


def test_a_broken_picture_is_named_and_the_others_are_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], printed: dict[str, list[float]]
) -> None:
    def broken(camera: Camera, row: int) -> bytes:
        return b"no picture" if row == BROKEN else road_jpeg(row)

    log = write_log(tmp_path / "hurt.mcap", STEERING, broken, cameras=["center"])
    assert call(main, log, "--run", "first", "--write", tmp_path / "kept.mcap") == 3
    skipped, step = capsys.readouterr().err.splitlines()
    assert skipped == f"skipped pictures that do not decode: 1 (hurt row {BROKEN} center)"
    assert step.endswith(f"bc-play {tmp_path / 'kept.mcap'}`")
    messages = read_messages(tmp_path / "kept.mcap")["/prediction/first"]
    rows = [row for row in range(ROWS) if row != BROKEN]
    assert [message.sequence for message, _ in messages] == rows
    assert [prediction.steering for _, prediction in messages] == pytest.approx(
        [printed["first"][row] for row in rows], abs=1e-4
    )


def test_an_unfinished_log_is_looked_at_as_far_as_it_goes(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], printed: dict[str, list[float]]
) -> None:
    whole = (project / "session.mcap").read_bytes()
    log = tmp_path / "killed.mcap.ab12cd.part"
    log.write_bytes(whole[: int(0.8 * len(whole))])
    assert call(main, log, "--run", "first", "--save", tmp_path / "x.rrd") == 3
    line, _ = capsys.readouterr().err.splitlines()
    assert f"{log}: unfinished" in line
    predicted = values(tmp_path / "x.rrd", "/steering/predicted_by/first")
    assert 20 < len(predicted) < ROWS
    assert predicted == pytest.approx(printed["first"][: len(predicted)], abs=1e-4)
    assert {path.name for path in tmp_path.iterdir()} == {log.name, "x.rrd"}


def test_what_cannot_be_is_one_line(project: Path, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "states.mcap", {}) as log:
        log.event(1, "nothing")
    weights = untrained_run(tmp_path / "wild") / "model.safetensors"
    save_file({name: np.full_like(value, np.nan) for name, value in load_file(weights).items()}, weights)
    with pytest.raises(UserError, match="no picture of the centre camera"):
        predict_log(tmp_path / "states.mcap", [project / "runs" / "first"])
    with pytest.raises(RunError, match="predicts a number that is not finite"):
        predict_log(project / "session.mcap", [tmp_path / "wild"])
    with pytest.raises(RunError, match="first: given 2 times"):
        predict_log(
            project / "session.mcap", [project / "runs" / "first", project / "runs" / "second" / ".." / "first"]
        )


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (("--attention",), "--run"),
        (("--write", "x.mcap"), "--run"),
        (("--run", "first", "--follow"), "--follow"),
        (("--run", "first", "--video", "x.mp4"), "--video"),
        (("--write", "x.mcap", "--video", "x.mp4"), "without --write"),
        (("--attention", "--video", "x.mp4", "--run", "first"), "without --run, --attention"),
        (("--run", "first", "--write", "x.mcap", "--attention"), "--attention"),
        (("--run", "first", "--write", "x.mcap", "--connect"), "--connect"),
        (("--run", "third", "--save", "x.rrd"), "in runs are first, second"),
    ],
)
def test_flags_that_contradict_each_other_are_one_line(
    project: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], expected: str
) -> None:
    before = sorted(project.iterdir())
    assert call(main, "session.mcap", *flags) == (1 if "third" in flags else 2)  # which is a name of no run
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line
    assert sorted(project.iterdir()) == before


def test_what_is_damaged_of_a_log_is_named_and_the_rest_is_predicted(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "hurt.mcap"
    data = bytearray((project / "session.mcap").read_bytes())
    data[len(data) // 2 : len(data) // 2 + 1000] = bytes(1000)
    log.write_bytes(data)
    assert call(main, log, "--run", "first", "--save", tmp_path / "x.rrd") == 3
    assert f"pictures in damaged chunks of {log}" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == [log, tmp_path / "x.rrd"]
