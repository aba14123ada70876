"""What is not quite a recording: a folder above it or in it, one of its files, a log of this toolkit."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from recorder import RecordingError, import_udacity
from recorder.import_cli import main
from recorder.sources.import_recording import import_recording
from tests.helpers.driving import one_line_in
from tests.helpers.logs import read_messages
from tests.helpers.other_logs import write_bag
from tests.helpers.tubs import record_2, write_tub_2
from tests.helpers.udacity import call, make_recording, paths

CSV = f"{paths(0)},0,1,0,9.5\n"


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with a recording of each kind, and others that are none."""
    make_recording(tmp_path / "udacity" / "recording", CSV, [0])
    car = tmp_path / "mycar"
    write_tub_2(car / "data", map(record_2, range(4)))
    (car / "models").mkdir()
    (car / "manage.py").touch()
    (tmp_path / "robot").mkdir()
    write_bag(tmp_path / "robot" / "bag", StoragePlugin.MCAP)
    return tmp_path


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("mycar", "mycar/data"),
        ("mycar/data/images", "mycar/data"),
        ("mycar/data/images/0_cam_image_array_.jpg", "mycar/data"),
        ("mycar/data/manifest.json", "mycar/data"),
        ("mycar/data/catalog_0.catalog", "mycar/data"),
        ("udacity", "udacity/recording"),
        ("udacity/recording/IMG", "udacity/recording"),
        ("udacity/recording/driving_log.csv", "udacity/recording"),
        ("robot", "robot/bag"),
        ("robot/bag/metadata.yaml", "robot/bag"),
    ],
)
def test_what_was_meant_is_said(home: Path, monkeypatch: pytest.MonkeyPatch, given: str, meant: str) -> None:
    monkeypatch.chdir(home)
    with pytest.raises(RecordingError) as error:
        import_recording(Path(given), Path("x.mcap"))
    assert str(error.value) == f"{given}: not a recording; did you mean {meant}?"
    with pytest.raises(RecordingError, match=rf"did you mean {home / meant}\?"):
        import_recording(home / given, home / "x.mcap")


def test_several_recordings_are_all_named_and_many_are_not(home: Path) -> None:
    with pytest.raises(RecordingError) as error:
        import_recording(home, home / "x.mcap")
    names = ["mycar/data", "robot/bag", "udacity/recording"]
    assert str(error.value).endswith(f"did you mean {' or '.join(str(home / name) for name in names)}?")
    shutil.copytree(home / "udacity", home / "udacity 2")
    with pytest.raises(RecordingError, match=r"recording or another one there\?"):
        import_recording(home, home / "x.mcap")


@pytest.mark.parametrize("given", ["nowhere", "mycar/models", "mycar/manage.py", "mycar/data/nothing"])
def test_nothing_is_guessed_where_nothing_is_near(home: Path, given: str) -> None:
    with pytest.raises(RecordingError) as error:
        import_recording(home / given, home / "x.mcap")
    assert "did you mean" not in str(error.value)


# Logs of this toolkit


def test_a_log_of_this_toolkit_needs_no_import(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    make_recording(tmp_path / "drive", CSV, [0])
    log = import_udacity(tmp_path / "drive", tmp_path / "mine" / "log.mcap").path
    assert call(main, log, "x") == 1
    assert "a log of this toolkit, which needs no import: copy it into sessions/" in (one_line_in(capsys))
    with pytest.raises(RecordingError, match="a session already: `bc-index`"):
        import_recording(log, log.with_name("x.mcap"))
    part = shutil.copy(log, tmp_path / "log.mcap.1a2b3c.part")
    with pytest.raises(RecordingError, match=r"`bc-log recover .*part`"):
        import_recording(Path(part), tmp_path / "x.mcap")


# Watching


@pytest.mark.parametrize("given", ["mycar/data", "robot/bag", "robot/bag/bag.mcap"])
def test_what_cannot_be_followed_is_refused(home: Path, capsys: pytest.CaptureFixture[str], given: str) -> None:
    assert call(main, home / given, "x", "--watch", "--sessions", home / "sessions") == 1
    assert "--watch follows folders of the Udacity simulator" in capsys.readouterr().err


def test_a_tub_without_any_manifest_is_still_one(tmp_path: Path) -> None:
    folder = write_tub_2(tmp_path / "data", map(record_2, range(5)), pictures=range(5), deleted=[1])
    (folder / "manifest.json").unlink()
    done = import_recording(folder, tmp_path / "log.mcap")
    states = [state.steering for _, state in read_messages(done.path)["/vehicle"]]
    assert states == [-1.0, 0.0, 0.25, 1.0, -1.0]
    assert done.skipped.counts == {"lists of deleted records that cannot be read": 1}
