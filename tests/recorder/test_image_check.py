"""Looking at pictures: which do not decode, which cameras are frozen, and that it is done once."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from common.car import CAMERAS, Camera
from dataset.frames.frame_flags import ImageFindings
from dataset.frames.image_check_cache import check_all_images, check_images, read_image_check
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.pictures.image_check import ImageCheck
from recorder.upkeep.check import check
from tests.helpers.logs import START_NS, STEP_NS
from tests.helpers.plain_mcap import plain_writer
from tests.helpers.udacity import jpeg

WHOLE = [jpeg(100 + number, number + 1) for number in range(20)]
CUT_OFF = WHOLE[0][: len(WHOLE[0]) // 2]
BROKEN: dict[tuple[Camera, int], bytes] = {
    ("center", 3): CUT_OFF,
    ("left", 0): b"",
    ("left", 7): CUT_OFF,
    ("left", 8): b"no picture",
    ("right", 19): CUT_OFF,
}


def picture(camera: Camera, row: int) -> bytes:
    """No two rows of a camera have the same."""
    return BROKEN.get((camera, row)) or (b"" if (camera, row) in BROKEN else WHOLE[row])


def frozen_right(camera: Camera, row: int) -> bytes:
    """The right camera has one picture in eight rows."""
    return WHOLE[4] if camera == "right" and 4 <= row < 12 else picture(camera, row)


def write_drive(
    path: Path,
    speed_mph: Sequence[float] = (9.0,) * 20,
    picture: Callable[[Camera, int], bytes] = picture,
) -> Path:
    """A log of one row of three pictures for each speed."""
    with LogWriter(path, {"source": "test"}, overwrite=True) as writer:
        for row, speed in enumerate(speed_mph):
            time_ns = START_NS + row * STEP_NS
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, picture(camera, row))
            writer.vehicle(time_ns, row, VehicleState(steering=row / 100, speed_mph=speed))
    return path


def findings(path: Path, kind: str) -> list[str]:
    return [finding.where for finding in check(path).findings if finding.kind == kind]


def fingerprint(path: Path) -> str:
    with Log(path) as log:
        return log.fingerprint


# The pictures themselves


def test_every_undecodable_picture_is_named_in_order_and_counted() -> None:
    told: list[int] = []
    with ThreadPoolExecutor(2) as pool:
        image_check = ImageCheck(pool, told.append)
        for row in range(150):
            image_check.add("/a", row, row, CUT_OFF if row in (0, 77) else WHOLE[row % 20])
            image_check.add("/b", row, row, b"" if row == 31 else WHOLE[(row + 1) % 20])
        image_check.finish()
    assert image_check.broken == [("/a", 0), ("/b", 31), ("/a", 77)]
    assert image_check.decoded == sum(told) == 300


@pytest.mark.parametrize(
    ("pictures", "moves", "expected"),
    [
        ("abcdef", "111111", []),
        ("aabbcc", "111111", []),  # a slow camera
        ("abbbcd", "111111", [(1, 3)]),
        ("aaabbb", "111111", [(0, 2), (3, 5)]),
        ("aaaaaa", "111111", [(0, 5)]),
        ("aaaaaa", "000000", []),  # the car stands: it sees the same
        ("aaaaaa", "000111", [(2, 5)]),
        ("aaaaaa", "001011", [(3, 5)]),
        ("ab" * 3, "111111", []),
        ("", "", []),
    ],
)
def test_three_equal_pictures_in_a_row_from_a_moving_car_are_frozen(
    pictures: str, moves: str, expected: list[tuple[int, int]]
) -> None:
    image_check = ImageCheck(None)
    for i, name in enumerate(pictures):
        image_check.add("/a", 100 + i, 5 * i, name.encode())
    standing = {(100 + i, 5 * i) for i, moving in enumerate(moves) if moving == "0"}
    assert [
        stretch for pictures in image_check.pictures.values() for stretch in pictures.frozen(standing)
    ] == expected


# bc-log check


def test_check_tells_frozen_and_broken_pictures_from_sound_ones(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "a.mcap", [9.0] * 10 + [0.0] * 10, frozen_right)
    assert findings(path, "pictures that do not decode") == [
        *("/camera/left row 0", "/camera/center row 3", "/camera/left row 7", "/camera/left row 8"),
        "/camera/right row 19",
    ]
    assert findings(path, "stretches of frozen pictures") == ["/camera/right rows 4 to 9"]  # from 10 on it stands
    assert check(path).pictures == 60
    assert check(path, look=False).pictures == 0


@pytest.mark.parametrize("topic", ["/vehicle", "/camera/center"])
def test_a_time_that_no_clock_shows_is_a_finding(tmp_path: Path, topic: str) -> None:
    path = tmp_path / "late.mcap"
    schema = "bc.VehicleState" if topic == "/vehicle" else "foxglove.CompressedImage"
    with plain_writer(path) as writer:
        channel = writer.register_channel(topic, "protobuf", writer.register_schema(schema, "protobuf", b""))
        writer.add_message(channel, 2**63, b"", 2**63, 7)
    assert findings(path, "impossible times") == [f"{topic} row 7"]


# The look of an index


def test_looking_at_a_log_finds_what_was_put_into_it(tmp_path: Path) -> None:
    told: list[int] = []
    with Log(write_drive(tmp_path / "a.mcap", picture=frozen_right)) as log:
        looked = check_images(log, told.append)
    assert looked == ImageFindings(
        60,
        {"center": ((3, 3),), "left": ((0, 0), (7, 8)), "right": ((19, 19),)},
        {"right": ((4, 11),)},
        (),
    )
    assert sum(told) == 60


@pytest.mark.parametrize("speed_mph", [[0.0] * 20, [float("nan")] * 20])
def test_a_car_whose_speed_is_unknown_counts_as_moving(tmp_path: Path, speed_mph: list[float]) -> None:
    with Log(write_drive(tmp_path / "a.mcap", speed_mph, lambda camera, row: WHOLE[0])) as log:
        frozen = check_images(log).frozen
    assert frozen == ({} if speed_mph[0] == 0 else dict.fromkeys(CAMERAS, ((0, 19),)))


def test_an_unchanged_log_is_looked_at_once(tmp_path: Path) -> None:
    logs = {name: write_drive(tmp_path / f"{name}.mcap") for name in ("a", "b")}
    index = tmp_path / "index"
    assert check_all_images(logs, index) == ["a", "b"]
    assert check_all_images(logs, index) == []
    for name, path in logs.items():
        with Log(path) as log:
            assert read_image_check(index, name, log.fingerprint) == check_images(log)
    write_drive(logs["b"], picture=lambda camera, row: WHOLE[row])
    assert read_image_check(index, "b", fingerprint(logs["b"])) is None
    assert check_all_images(logs, index) == ["b"]
    looked = read_image_check(index, "b", fingerprint(logs["b"]))
    assert looked is not None
    assert not any(looked.broken.values())


SOUND: Mapping[str, Any] = {
    "format": 1,
    "fingerprint": "f",
    "pictures": 10,
    "broken": {"left": [[0, 2], [3, 3]]},
    "frozen": {},
}


WRONG_VALUES: Sequence[Any] = (None, {"left": 1})
WRONG_STRETCHES = (
    *("[[2,1]]", "[[0,2],[2,3]]", "[[5,6],[0,1]]", "[[-1,0]]"),
    *("[[0]]", "[[0,1e9]]", "[[0,true]]", "[0,1]"),
)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "\xff",
        "[" * 100_000,
        *(json.dumps({**SOUND, "pictures": wrong}) for wrong in (-1, 1.5, True, 2**62)),
        *(json.dumps({**SOUND, name: wrong}) for name in SOUND for wrong in WRONG_VALUES),
        *(json.dumps({**SOUND, "broken": {"left": json.loads(wrong)}}) for wrong in WRONG_STRETCHES),
        json.dumps({**SOUND, "broken": {"rear": [[0, 2]]}}),  # a camera of a later version
        json.dumps({name: value for name, value in SOUND.items() if name != "frozen"}),
    ],
)
def test_a_damaged_look_counts_as_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "looks").mkdir()
    (tmp_path / "looks" / "a.json").write_text(text, encoding="latin-1")
    assert read_image_check(tmp_path, "a", "f") is None
