"""A DonkeyCar tub, of version 1 or 2, becomes a log."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder import Imported, Log, RecordingError
from recorder.sources.donkeycar_tub import is_tub
from recorder.sources.import_recording import import_recording
from recorder.sources.picture_folder import MISSING
from tests.helpers.logs import read_messages
from tests.helpers.tubs import FIRST_MS, jpeg, name_1, name_2, record_1, record_2, write_tub_1, write_tub_2

START_NS = 1_679_574_289_750_000_000
FIRST_NS = FIRST_MS * 1_000_000
STEP_NS = 50_000_000
STATES = [(-1.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.25, 0.0, 0.5571428571428572), (1.0, 1.0, 0.0)]


def imported(folder: Path) -> Imported:
    return import_recording(folder, folder.parent / "imported.mcap")


def frames_of(log: Path) -> list[tuple[int, int, tuple[float, float, float], bytes]]:
    """Log time, sequence, (steering, throttle, brake) and picture of every frame, by mcap's own reader."""
    messages = read_messages(log)
    assert set(messages) <= {"/vehicle", "/camera/center", "/events"}
    frames = []
    for (driven, state), (seen, image) in zip(messages["/vehicle"], messages["/camera/center"], strict=True):
        assert (driven.log_time, driven.sequence) == (seen.log_time, seen.sequence)
        assert image.format == "jpeg"
        assert math.isnan(state.speed_mph)
        values = (state.steering, state.throttle, state.brake)
        frames.append((driven.log_time, driven.sequence, values, image.data))
    return frames


def kept(log: Path) -> list[int]:
    """Which of the pictures 0..9 are in a log."""
    numbers = {jpeg(number): number for number in range(10)}
    return [numbers[data] for *_, data in frames_of(log)]


def metadata_of(log: Path) -> dict[str, str]:
    with Log(log) as opened:
        return opened.metadata


def tub_2(folder: Path) -> Path:
    return write_tub_2(folder, map(record_2, range(4)))


def tub_1(folder: Path) -> Path:
    return write_tub_1(folder, {index: record_1(index) for index in range(4)})


def test_every_record_of_a_version_2_tub(tmp_path: Path) -> None:
    done = imported(tub_2(tmp_path / "data"))
    assert (done.rows, done.pictures, list(done.skipped)) == (4, 4, [])
    assert frames_of(done.path) == [
        (FIRST_NS + index * STEP_NS, index, STATES[index], jpeg(index)) for index in range(4)
    ]
    metadata = metadata_of(done.path)
    del metadata["toolkit"]
    assert metadata == {"source": "donkeycar", "recording": "data", "tub_version": "2", "clock": "recorded"}


def test_every_record_of_a_version_1_tub(tmp_path: Path) -> None:
    done = imported(tub_1(tmp_path / "tub_1_19-02-12"))
    assert (done.rows, done.pictures, list(done.skipped)) == (4, 4, [])
    assert frames_of(done.path) == [
        (START_NS + 100_000_000 + index * STEP_NS, index, STATES[index], jpeg(index)) for index in range(4)
    ]
    metadata = metadata_of(done.path)
    del metadata["toolkit"]
    assert metadata == {
        "source": "donkeycar",
        "recording": "tub_1_19-02-12",
        "tub_version": "1",
        "clock": "recorded",
    }


def without(record: dict[str, object], field: str) -> dict[str, object]:
    return {key: value for key, value in record.items() if key != field}


def test_records_without_a_time_are_20_a_second_from_the_start(tmp_path: Path) -> None:
    old = write_tub_1(tmp_path / "old", {index: without(record_1(index), "milliseconds") for index in (0, 1, 3)})
    new = write_tub_2(tmp_path / "new", [without(record_2(index), "_timestamp_ms") for index in (0, 1, 3)])
    for folder in (old, new):
        done = import_recording(folder, folder / "imported.mcap")
        times = [time_ns for time_ns, *_ in frames_of(done.path)]
        assert times == [START_NS, START_NS + STEP_NS, START_NS + 3 * STEP_NS]
        assert metadata_of(done.path)["clock"].startswith("20 Hz")
        assert "start" not in metadata_of(done.path)


@pytest.mark.parametrize("start_s", [None, math.nan, -1.0])
def test_a_tub_without_a_start_begins_in_1970_and_its_log_reports_so(
    tmp_path: Path, start_s: float | None
) -> None:
    done = imported(write_tub_1(tmp_path / "tub", {0: record_1(0)}, start_s=start_s))
    assert [time_ns for time_ns, *_ in frames_of(done.path)] == [100_000_000]
    assert metadata_of(done.path)["start"].startswith("1970")


def test_deleted_records_are_left_out_and_named(tmp_path: Path) -> None:
    new = write_tub_2(tmp_path / "new", map(record_2, range(4)), deleted=[0, 3])
    old = tub_1(tmp_path / "old")
    (old / "exclude.json").write_text("[3, 0]")
    names = [["catalog_0.catalog line 1", "catalog_1.catalog line 1"], ["record_0.json", "record_3.json"]]
    for folder, expected in zip((new, old), names, strict=True):
        done = import_recording(folder, folder / "imported.mcap")
        assert kept(done.path) == [1, 2]
        assert list(done.skipped) == [("deleted records", name) for name in expected]


@pytest.mark.parametrize("mode", ["local_angle", "pilot", 7])
def test_what_the_pilot_drove_is_no_label(tmp_path: Path, mode: object) -> None:
    pilot = record_2(1, **{"user/mode": mode, "pilot/angle": 0.75})
    done = imported(write_tub_2(tmp_path / "data", [record_2(0), pilot, without(record_2(2), "user/mode")]))
    assert kept(done.path) == [0, 2]
    assert done.skipped.counts["records driven by DonkeyCar's pilot"] == 1


@pytest.mark.parametrize(
    "data", [jpeg(1)[:-200], b"\x89PNG\r\n\x1a\n", None], ids=["cut off", "another format", "missing"]
)
def test_a_record_without_a_whole_picture_is_left_out_and_named(tmp_path: Path, data: bytes | None) -> None:
    old, new = tub_1(tmp_path / "old"), tub_2(tmp_path / "new")
    for folder, picture in ((old, name_1(1)), (new, f"images/{name_2(1)}")):
        (folder / picture).unlink()
        if data is not None:
            (folder / picture).write_bytes(data)
        done = import_recording(folder, folder / "imported.mcap")
        assert kept(done.path) == [0, 2, 3]
        assert [name for _, name in done.skipped] == [Path(picture).name]


def test_a_picture_without_a_record_is_named(tmp_path: Path) -> None:
    done = imported(write_tub_2(tmp_path / "data", map(record_2, range(3)), pictures=range(5)))
    assert list(done.skipped) == [("pictures without a row", name_2(index)) for index in (3, 4)]


HUGE = "1" + "0" * 400
NOT_NUMBERS = ["NaN", HUGE, "1e999", '"0.5"', "true", "null"]


@pytest.mark.parametrize("field", ["user/angle", "user/throttle"])
@pytest.mark.parametrize("text", NOT_NUMBERS)
def test_a_value_that_is_no_finite_number_costs_its_record_only(tmp_path: Path, field: str, text: str) -> None:
    broken = json.dumps(record_2(1, **{field: "HERE"})).replace('"HERE"', text).encode() + b"\r\n"
    done = imported(write_tub_2(tmp_path / "data", [record_2(0), broken, record_2(2), record_2(3)]))
    assert kept(done.path) == [0, 2, 3]
    ((reason, _),) = done.skipped
    assert "is not a finite number" in reason


@pytest.mark.parametrize("text", ["NaN", HUGE, '"0.5"', "-1", "9223372036855", "1e300"])
def test_a_time_that_no_log_can_hold_costs_its_record_only(tmp_path: Path, text: str) -> None:
    broken = json.dumps(record_2(1, _timestamp_ms="HERE")).replace('"HERE"', text).encode() + b"\r\n"
    done = imported(write_tub_2(tmp_path / "data", [record_2(0), broken, record_2(2), record_2(3)]))
    assert kept(done.path) == [0, 2, 3]
    ((reason, _),) = done.skipped
    assert "time" in reason


NOT_RECORDS = [b"", b"{", b"[1]", b"\xff\xfe", b"[" * 100_000, b"9" * 5_000, b'{"a": "\\ud800']


@pytest.mark.parametrize("line", NOT_RECORDS, ids=range(len(NOT_RECORDS)))
def test_a_record_that_is_not_json_is_named_and_the_others_are_kept(tmp_path: Path, line: bytes) -> None:
    old = write_tub_1(tmp_path / "old", {0: record_1(0), 1: line, 2: record_1(2)}, pictures=[0, 2])
    new = write_tub_2(tmp_path / "new", [record_2(0), line + b"\n", record_2(2)], pictures=[0, 2])
    for folder, names in ((old, ["record_1.json"]), (new, ["catalog_0.catalog line 2"] if line else [])):
        done = import_recording(folder, folder / "imported.mcap")
        assert kept(done.path) == [0, 2]
        assert [name for _, name in done.skipped] == names


def test_a_catalogue_that_is_cut_off_loses_its_last_record_only(tmp_path: Path) -> None:
    folder = tub_2(tmp_path / "data")
    catalog = folder / "catalog_0.catalog"
    catalog.write_bytes(catalog.read_bytes()[:-20])
    done = imported(folder)
    assert kept(done.path) == [0, 1, 3]
    assert ("records that cannot be read as a JSON object", "catalog_0.catalog line 3") in done.skipped


@pytest.mark.parametrize("kept_bytes", [0, -3])
def test_a_manifest_that_is_cut_off_hides_no_record_but_is_named(tmp_path: Path, kept_bytes: int) -> None:
    """A car that loses its power leaves it so; what was deleted is then not known."""
    folder = write_tub_2(tmp_path / "data", map(record_2, range(4)), deleted=[1])
    manifest = folder / "manifest.json"
    manifest.write_bytes(manifest.read_bytes()[:kept_bytes])
    done = imported(folder)
    assert kept(done.path) == [0, 1, 2, 3]
    assert list(done.skipped) == [("lists of deleted records that cannot be read", "manifest.json")]


def test_catalogues_that_are_missing_or_not_listed_are_named(tmp_path: Path) -> None:
    folder = write_tub_2(tmp_path / "data", map(record_2, range(4)), pictures=range(3))
    (folder / "catalog_1.catalog").rename(folder / "catalog_7.catalog")
    done = imported(folder)
    assert kept(done.path) == [0, 1, 2]
    assert list(done.skipped) == [
        ("catalogues that are not there", "'catalog_1.catalog'"),
        ("catalogues that the manifest does not name (without manifest.json, all are read)", "catalog_7.catalog"),
    ]


# Somebody else's data


@pytest.mark.parametrize("prefix", ["../../", "C:\\mycar\\data\\"])
def test_only_the_file_name_of_a_picture_counts(tmp_path: Path, prefix: str) -> None:
    """`../../` names a picture that is there, outside of the tub: the one inside is taken."""
    folder = tmp_path / "one" / "data"
    records = [record_2(index, **{"cam/image_array": prefix + name_2(index)}) for index in range(2)]
    write_tub_2(folder, records, pictures=[0])
    for outside in (tmp_path, tmp_path / "one"):
        for index in range(2):
            (outside / name_2(index)).write_bytes(jpeg(9))
    done = imported(folder)
    assert kept(done.path) == [0]
    assert done.skipped.counts == {MISSING: 1}


@pytest.mark.parametrize("name", ["images/" + name_2(1), "catalog_1.catalog"])
def test_a_link_out_of_the_tub_is_not_followed(tmp_path: Path, name: str) -> None:
    folder = tub_2(tmp_path / "downloaded")
    private = (folder / name).rename(tmp_path / "private")
    (folder / name).symlink_to(private)
    link = name.removeprefix("images/")
    done = imported(folder)
    assert [name for reason, name in done.skipped if "links out of" in reason] == [link]
    assert kept(done.path) == ([0, 2, 3] if link == name_2(1) else [0, 1, 2])


@pytest.mark.parametrize("name", ["meta.json", "record_1.json", name_1(1)])
def test_a_link_out_of_a_version_1_tub_is_not_followed(tmp_path: Path, name: str) -> None:
    folder = tub_1(tmp_path / "downloaded")
    private = (folder / name).rename(tmp_path / "private")
    (folder / name).symlink_to(private)
    done = imported(folder)
    assert ("links out of the tub", name) in done.skipped
    assert kept(done.path) == ([0, 1, 2, 3] if name == "meta.json" else [0, 2, 3])
    if name == "meta.json":
        assert metadata_of(done.path)["start"].startswith("1970")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=4,
)
fields = st.sampled_from(
    ["_index", "_timestamp_ms", "cam/image_array", "user/angle", "user/throttle", "user/mode"]
)
odd_records = st.dictionaries(fields, json_values).map(lambda changes: record_2(1, **changes))
junk_lines = st.binary(max_size=40) | odd_records.map(lambda record: json.dumps(record).encode())


@given(
    catalog=st.lists(junk_lines, max_size=4), last=junk_lines | json_values.map(lambda v: json.dumps(v).encode())
)
def test_junk_among_the_records_costs_no_sound_record(catalog: list[bytes], last: bytes) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = write_tub_2(Path(place) / "data", [record_2(0), record_2(2)], pictures=[0, 1, 2])
        first, second = (folder / "catalog_0.catalog").read_bytes().splitlines()
        (folder / "catalog_0.catalog").write_bytes(b"\n".join([first, *catalog, second]))
        manifest = folder / "manifest.json"
        manifest.write_bytes(b"\n".join([*manifest.read_bytes().splitlines()[:4], last]))
        numbers = kept(imported(folder).path)
        assert [number for number in numbers if number != 1] == [0, 2]
        assert len(numbers) <= 3


# What a user sees


def test_a_tub_is_reported_from_other_folders(tmp_path: Path) -> None:
    assert is_tub(tub_2(tmp_path / "new"))
    old = tub_1(tmp_path / "old")
    assert is_tub(old)
    (old / "meta.json").unlink()
    assert is_tub(old)
    assert kept(imported(old).path) == [0, 1, 2, 3]
    udacity = tmp_path / "udacity"
    (udacity / "IMG").mkdir(parents=True)
    (udacity / "driving_log.csv").write_text("")
    assert not is_tub(udacity)
    assert not is_tub(tmp_path / "nowhere")
    assert not is_tub(old / "record_0.json")


RECORDS = [record_2(index) for index in range(4)]


@pytest.mark.parametrize(
    "make",
    [
        Path.mkdir,
        lambda folder: write_tub_2(folder, []),
        lambda folder: write_tub_2(folder, RECORDS, pictures=[]),
        lambda folder: (write_tub_2(folder, RECORDS, pictures=[]) / "images").rmdir(),
        lambda folder: write_tub_2(folder, RECORDS, deleted=range(4)),
        lambda folder: None,
    ],
    ids=["empty", "no records", "no pictures", "no images", "all deleted", "not there"],
)
def test_a_tub_without_anything_usable_writes_nothing(tmp_path: Path, make: Callable[[Path], object]) -> None:
    folder = tmp_path / "tub"
    make(folder)
    with pytest.raises(RecordingError) as error:
        import_recording(folder, tmp_path / "sessions" / "tub.mcap")
    assert str(folder) in str(error.value)
    assert len(str(error.value).splitlines()) == 1
    assert not (tmp_path / "sessions").exists()
