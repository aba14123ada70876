"""Telemetry comes from outside and may be anything; the answer is always a command."""

from __future__ import annotations

import base64
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive.config import DriveConfig
from drive.control.driver import Driver
from model import Pilot, load_pilot
from recorder.server.telemetry import (
    MAX_IMAGE_BYTES,
    Telemetry,
    TelemetryError,
    check_whole_picture,
    format_command,
    parse_telemetry,
)
from recorder.server.world import MAX_WORLD_NUMBER, MEMBERS, World, parse_world
from simulator.pose import Pose
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.repository import ROOT

PICTURE = bytes(range(256))


def telemetry(**fields: Any) -> dict[str, Any]:
    """What the simulator tells, with some fields replaced (or left out: ...)."""
    values = {
        "steering_angle": "-12.5000",
        "throttle": "0.2500",
        "speed": "9.0100",
        "image": base64.b64encode(PICTURE).decode(),
    }
    return {name: value for name, value in {**values, **fields}.items() if value is not ...}


def test_degrees_become_shares_and_the_picture_its_bytes() -> None:
    assert parse_telemetry(telemetry()) == Telemetry(-0.5, 0.25, 9.01, PICTURE, observed_separator=".")


@pytest.mark.parametrize(
    ("speed", "throttle", "speed_mph"),
    [
        ("1,234,567.2500", "1.0000", 1234567.25),
        ("7.8E-05", "0.0000", 7.8e-5),
        (" 9.5 ", "0.0000", 9.5),
        ("30", "1", 30.0),
        ("1.234.567,2500", "1,0000", 1234567.25),
        ("1\u202f234,5000", "0,0000", 1234.5),  # French of newer machines
        (9.25, 1, 9.25),
    ],
)
def test_numbers_as_every_machine_writes_them(speed: object, throttle: object, speed_mph: float) -> None:
    assert parse_telemetry(telemetry(speed=speed, throttle=throttle)).speed_mph == pytest.approx(speed_mph)


@pytest.mark.parametrize(
    ("throttle", "separator"), [("0.2500", "."), ("0,2500", ","), ("0/2500", "/"), (0.25, "."), ("1", ".")]
)
def test_the_throttle_shows_how_the_machine_separates_decimals(throttle: object, separator: str) -> None:
    assert parse_telemetry(telemetry(throttle=throttle)).decimal_separator == separator


@pytest.mark.parametrize(
    ("separator_before", "throttle", "speed", "angle", "speed_mph", "degrees", "separator"),
    [
        (None, "0", "9,25", "-1,5", 9.25, -1.5, ","),  # C#'s ToString()
        (None, "1", "9.25", "-1.5", 9.25, -1.5, "."),
        (None, "0,5", "9", "0", 9.0, 0.0, ","),
        (",", "0", "9", "0", 9.0, 0.0, ","),
        (",", "0", "1,234", "0", 1.234, 0.0, ","),
        (".", "0", "1,234", "0", 1234.0, 0.0, "."),
        (None, "0", "1,234", "0", 1234.0, 0.0, "."),  # "N4" never has three decimals
        (",", "0", "1,234", "0.5", 1234.0, 0.5, "."),  # it is told anew
        (None, "0", "0,125", "0", 0.125, 0.0, ","),
        (",", "0", "1,234.5000", "0", 1234.5, 0.0, "."),
        (",", 0, "9", "-1,125", 9.0, -1.125, ","),
        (".", "0.5000", "9,25", "0", 9.25, 0.0, "."),
        (None, "0", "1.234.567", "0", 1234567.0, 0.0, ","),
    ],
)
def test_whole_numbers_do_not_change_a_known_decimal_separator(
    separator_before: str | None,
    throttle: object,
    speed: str,
    angle: str,
    speed_mph: float,
    degrees: float,
    separator: str,
) -> None:
    parsed = parse_telemetry(telemetry(throttle=throttle, speed=speed, steering_angle=angle), separator_before)
    assert (parsed.speed_mph, parsed.decimal_separator) == (speed_mph, separator)
    assert parsed.steering == pytest.approx(degrees / 25)


CULTURES = [
    ("-1,234.5000", "0.2500", "-0.2167"),  # en-US, and 75 more
    ("-1.234,5000", "0,2500", "-0,2167"),  # de-DE
    ("-1\u00a0234,5000", "0,2500", "-0,2167"),  # fr-FR
    ("-1\u00a0234.5000", "0.2500", "-0.2167"),  # fr-CH
    ("-1'234.5000", "0.2500", "-0.2167"),  # de-CH
    ("-1\u2019234.5000", "0.2500", "-0.2167"),  # rm-CH
    ("- 1.234,5000", "0,2500", "- 0,2167"),  # hr-HR
    ("- 1,234.5000", "0.2500", "- 0.2167"),  # km-KH
    ("1,234.5000-", "0.2500", "0.2167-"),  # ar-SA, and 15 more
    ("1,234/5000-", "0/2500", "0/2167-"),  # fa-IR
    ("\u200e\u22121\u066c234\u066b5000", "0\u066b2500", "\u200e\u22120\u066b2167"),  # fa-IR, newer .NET
    ("\u061c-1\u066c234\u066b5000", "0\u066b2500", "\u061c-0\u066b2167"),  # ar-EG, newer .NET
]


@pytest.mark.parametrize(("speed", "throttle", "degrees"), CULTURES)
def test_every_culture_is_understood_and_answered_in_kind(speed: str, throttle: str, degrees: str) -> None:
    parsed = parse_telemetry(telemetry(speed=speed, throttle=throttle, steering_angle=degrees))
    assert (parsed.speed_mph, parsed.throttle) == (-1234.5, 0.25)
    assert parsed.steering == pytest.approx(-0.2167 / 25)
    separator = throttle[1]
    assert format_command(-0.25, 0.5, parsed.decimal_separator) == {
        "steering_angle": f"-0{separator}250000",  # a minus behind is written there, and not read
        "throttle": f"0{separator}500000",
    }


def test_what_is_out_of_range_is_reported_as_it_came() -> None:
    for degrees, expected in (("25.0000", 1.0), ("-25.0000", -1.0), ("26", 1.04), ("-4,000.0", -160.0)):
        assert parse_telemetry(telemetry(steering_angle=degrees)).steering == expected
    for throttle in ("1.5", "-0.5"):
        assert parse_telemetry(telemetry(throttle=throttle)).throttle == float(throttle)


@pytest.mark.parametrize(
    ("changed", "kind", "reason"),
    [
        ({"speed": ...}, "speed is missing", "speed is missing (received: steering_angle, throttle, image)"),
        (
            {"speed": ..., "image": ..., "velocity": 3, "x" * 99: 1},
            "speed and image are missing",
            f"speed and image are missing (received: steering_angle, throttle, velocity, {'x' * 30}...)",
        ),
        ({"speed": "fast"}, "speed is not a number", "speed is not a number (fast)"),
        ({"speed": "\u0661"}, "speed is not a number", "speed is not a number (\u0661)"),
        ({"speed": "\x1b[2J"}, "speed is not a number", "speed is not a number (\\x1b[2J)"),
        ({"speed": [1]}, "speed is not a number but a list", "speed is not a number but a list"),
        (
            {"image": "data:image/jpeg;base64,AAAA"},
            "image begins with data:",
            "image begins with data: (send only what comes after base64,)",
        ),
    ],
)
def test_the_reason_names_what_came_and_its_kind_does_not(
    changed: dict[str, object], kind: str, reason: str
) -> None:
    with pytest.raises(TelemetryError) as error:
        parse_telemetry(telemetry(**changed))
    assert (error.value.kind, str(error.value)) == (kind, reason)


@pytest.mark.parametrize(
    ("changed", "speed_mph", "separator"),
    [
        ({"image": "%%%"}, 9.01, "."),
        ({"image": ..., "speed": "9,0100", "throttle": "0,2500", "steering_angle": "0,0000"}, 9.01, ","),
        ({"throttle": ..., "speed": "9,0100", "steering_angle": "-12,5000"}, 9.01, ","),
        ({"speed": ...}, None, "."),
        ({"speed": "fast", "throttle": None, "steering_angle": None}, None, None),
    ],
)
def test_what_can_be_read_of_a_bad_telemetry_is_reported(
    changed: dict[str, object], speed_mph: float | None, separator: str | None
) -> None:
    with pytest.raises(TelemetryError) as error:
        parse_telemetry(telemetry(world={"time_s": 1.5}, **changed))
    assert (error.value.speed_mph, error.value.decimal_separator) == (speed_mph, separator)
    assert error.value.world == World(time_s=1.5)


@pytest.mark.parametrize(
    ("picture", "kind"),
    [
        (b"\x89PNG\r\n", "image is a PNG that is cut off or damaged"),
        (b"\xff\xd8\xff", "image is a JPEG that is cut off or damaged"),
        (b"", "image is not a JPEG or PNG"),
        (bytes(99), "image is not a JPEG or PNG"),
    ],
)
def test_a_picture_that_is_no_whole_jpeg_or_png_is_named(picture: bytes, kind: str) -> None:
    with pytest.raises(TelemetryError) as error:
        check_whole_picture(picture)
    assert error.value.kind == kind


@pytest.mark.parametrize(
    ("left", "problem"),
    [
        (road_jpeg(1)[:-100], "image_left is a JPEG that is cut off or damaged"),
        (b"RIFF\0\0\0\0WEBP", "image_left is not a JPEG or PNG"),
        ("%%", "image_left is not base64"),
        (7, "image_left is not a string but a number"),
        ("A" * (MAX_IMAGE_BYTES + 4), f"image_left is larger than {MAX_IMAGE_BYTES:,} bytes"),
    ],
    ids=lambda value: repr(value)[:12],
)
def test_an_unusable_side_picture_is_named_and_the_others_are_kept(left: object, problem: str) -> None:
    fields = {"image_left": base64.b64encode(left).decode() if isinstance(left, bytes) else left}
    parsed = parse_telemetry(telemetry(image_right=base64.b64encode(road_jpeg(2)).decode(), **fields))
    assert (parsed.picture, parsed.side_pictures, parsed.side_problems) == (
        PICTURE,
        {"right": road_jpeg(2)},
        (problem,),
    )


@pytest.mark.parametrize("speed", [1e300, "-1e8"])
def test_a_speed_that_no_distance_can_be_made_of_is_refused(speed: object) -> None:
    with pytest.raises(TelemetryError, match=r"^speed is beyond"):
        parse_telemetry(telemetry(speed=speed))


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (..., "missing"),
        (None, "null"),
        ("", "empty"),
        (b"\xff\xd8", "not a string"),
        (["/9j/"], "not a string"),
        ("no*base64!", "not base64"),
        ("/9j/4", "not base64"),
        ("/9j/é", "not base64"),
        ("A" * (MAX_IMAGE_BYTES + 4), "larger"),
    ],
    ids=lambda value: repr(value)[:12],
)
def test_what_is_not_a_picture_in_base64_is_refused(value: object, reason: str) -> None:
    with pytest.raises(TelemetryError, match=f"^image is .*{reason}"):
        parse_telemetry(telemetry(image=value))


SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.text("0123456789.,-eE '", max_size=12)
)
JSON = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3)
)
TOLD = st.fixed_dictionaries(
    {}, optional={name: JSON | st.just(value) for name, value in telemetry(world={"time_s": 1.0}).items()}
)


@given(JSON | TOLD)
def test_anything_is_either_a_telemetry_or_a_telemetry_error(data: object) -> None:
    try:
        parsed = parse_telemetry(data)
    except TelemetryError:
        return
    assert all(math.isfinite(number) for number in (parsed.steering, parsed.throttle, parsed.speed_mph))


@given(st.floats(-1, 1), st.floats(-1, 1), st.sampled_from(".,/\u066b"))
def test_a_command_is_two_strings_that_the_clients_culture_reads(
    steering: float, throttle: float, separator: str
) -> None:
    answer = format_command(steering, throttle, separator)
    assert set(answer) == {"steering_angle", "throttle"}
    for text, value in ((answer["steering_angle"], steering), (answer["throttle"], throttle)):
        assert isinstance(text, str)
        assert [character for character in text if character not in "-0123456789"] == [separator]
        read = float(text.replace(separator, "."))  # no thousands separators: 1 at most
        assert read == pytest.approx(value, abs=1e-6)
        assert -1 <= read <= 1
        assert "e" not in text


WORLD = World(12.5, -3.0, 4.25, 0.5, 1.5, -0.01, 0.02, -1.25, 0.75, 2, -0.5, 0.25)


def world(**values: Any) -> dict[str, Any]:
    """What the built-in simulator tells, with some values replaced (or left out: ...)."""
    return {name: value for name, value in {**vars(WORLD), **values}.items() if value is not ...}


def used(value: object, decimal: str = ".") -> World | None:
    """What is used of a world with which nothing is wrong."""
    parsed, problems = parse_world(value, decimal)
    assert problems == ()
    return parsed


def problem(value: object, decimal: str = ".") -> str:
    """The one thing that is wrong with it."""
    (text,) = parse_world(value, decimal)[1]
    return text


def test_a_world_is_taken_where_it_is_reported() -> None:
    assert used(world()) == WORLD
    assert used(world(more=["of", "it"])) == WORLD
    assert used(None) is None


def test_each_member_may_be_reported_by_itself() -> None:
    assert used({"time_s": 1.5}) == World(time_s=1.5)
    assert used({"time_s": 1.5, "laps": None}) == World(time_s=1.5)
    assert used({"laps": 0.5, "interventions": 0}) == World(laps=0.5, interventions=0)
    pose = {name: world()[name] for name in MEMBERS[1:7]}
    parsed = used(pose)
    assert parsed is not None
    assert parsed.pose == Pose(-3.0, 4.25, 0.5, 1.5, -0.01, 0.02)
    assert (parsed.time_s, parsed.expert) == (None, None)
    assert WORLD.expert == (-0.5, 0.25)


@pytest.mark.parametrize("time_s", [-0.96, 0, 1e12, " -3 ", "1e-3"])
def test_a_clock_may_begin_before_0_and_numbers_may_stand_in_strings(time_s: float | str) -> None:
    parsed = used({"time_s": time_s})
    assert parsed == World(time_s=float(time_s))
    assert parsed is not None
    assert type(parsed.time_s) is float


def test_strings_have_the_decimal_point_of_the_telemetry() -> None:
    assert used({"offset": "-0,5"}, decimal=",") == World(offset=-0.5)
    assert used({"offset": -0.5}, decimal=",") == World(offset=-0.5)
    for text, decimal in (("-0,5", "."), ("0.5", ","), ("1,234.5", "."), ("1.234,5", ",")):
        # a half, or five? nobody knows
        assert problem({"offset": text}, decimal) == "offset is a string that is no plain number"


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("time_s", True, "time_s is not a number but true or false"),
        ("laps", [1.0], "laps is not a number but a list"),
        ("offset", "", "offset is a string that is no plain number"),
        ("offset", "٠", "offset is a string that is no plain number"),
        ("time_s", math.nan, "time_s is beyond 1e+12, or no number"),
        ("laps", 10**400, "laps is beyond 1e+09, or no number"),
        ("laps", "9e99", "laps is beyond 1e+09, or no number"),
        ("offset", 2 * MAX_WORLD_NUMBER, "offset is beyond 1e+09, or no number"),
        ("interventions", -1, "interventions is not a whole number from 0 on"),
        ("interventions", 0.5, "interventions is not a whole number from 0 on"),
    ],
)
def test_what_cannot_be_used_is_named_and_the_rest_is_used(name: str, value: object, error: str) -> None:
    parsed, problems = parse_world(world(**{name: value}))
    assert problems == (error,)
    assert parsed == World(**world(**{name: None}))


@pytest.mark.parametrize("value", [{}, {"time": 3}])
def test_names_that_nobody_knows_are_reported_those_that_are(value: object) -> None:
    assert parse_world(value)[0] is None
    assert all(name in problem(value) for name in MEMBERS)


@given(
    JSON | st.fixed_dictionaries({}, optional={name: SCALARS | st.just(value) for name, value in world().items()}),
    st.sampled_from(".,/\u066b"),
)
def test_any_world_is_one_of_finite_numbers(value: object, decimal: str) -> None:
    parsed, problems = parse_world(value, decimal)
    assert parsed is not None or problems or value is None or isinstance(value, dict)
    if parsed is None:
        return
    numbers = [number for number in vars(parsed).values() if number is not None]
    assert numbers
    assert all(math.isfinite(number) for number in numbers)
    assert (parsed.pose is None) == (parsed.x_m is None)
    assert all(-1 <= command <= 1 for command in parsed.expert or ())


# While it is driven


@pytest.fixture(scope="module")
def pilot(tmp_path_factory: pytest.TempPathFactory) -> Pilot:
    return load_pilot(untrained_run(tmp_path_factory.mktemp("runs") / "run"))


def telling(**more: object) -> dict[str, Any]:
    return {
        "steering_angle": "0.0000",
        "throttle": "0.1000",
        "speed": "9.0000",
        "image": base64.b64encode(road_jpeg(1)).decode(),
        **more,
    }


def test_what_is_wrong_with_a_world_is_named_once(pilot: Pilot) -> None:
    driver = Driver(pilot, DriveConfig())
    worlds = [{"time_s": k / 10, "laps": "half", **({"offset": True} if k > 2 else {})} for k in range(6)]
    answers = [driver.decide(telling(world=value), 0.0, now_s=0.0).events for value in worlds]
    laps = "the simulator's world is not used whole: laps is a string that is no plain number"
    offset = "the simulator's world is not used whole: offset is not a number but true or false"
    assert answers == [(laps,), (), (), (offset,), (), ()]


def test_a_simulator_that_sends_only_its_time_is_driven_by_it(pilot: Pilot) -> None:
    """Steering that is smoothed over a second follows the simulator's seconds, whatever the clock shows."""

    def steered(seconds_of_the_clock: float) -> list[float]:
        driver = Driver(pilot, DriveConfig(smooth_s=1.0))
        return [
            driver.decide(telling(world={"time_s": k / 10}), 0.0, now_s=k * seconds_of_the_clock).steering
            for k in range(5)
        ]

    assert steered(0.001) == steered(7.0)
    assert len({*steered(7.0)}) == 5


def test_the_docs_name_every_member() -> None:
    page = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
    assert [name for name in MEMBERS if f"`{name}`" not in page] == []


def test_an_experts_command_stays_within_its_bounds() -> None:
    for parsed, expected in ((1.5, 1.0), (-7, -1.0), (1e8, 1.0), (-1.0, -1.0)):
        assert used({"expert_steering": parsed, "expert_throttle": parsed}) == World(
            expert_steering=expected, expert_throttle=expected
        )
