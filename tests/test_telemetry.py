"""Telemetry comes from outside and may be anything; the answer is always a command."""

from __future__ import annotations

import base64
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive.speed import SpeedController
from recorder.telemetry import (
    MAX_IMAGE_BYTES,
    Telemetry,
    TelemetryError,
    format_command,
    parse_telemetry,
)

PICTURE = bytes(range(256))


def telemetry(**fields: Any) -> dict[str, Any]:
    """What the simulator tells, with some fields replaced (or left out: ...)."""
    told = {
        "steering_angle": "-12.5000",
        "throttle": "0.2500",
        "speed": "9.0100",
        "image": base64.b64encode(PICTURE).decode(),
    }
    return {name: value for name, value in {**told, **fields}.items() if value is not ...}


def test_degrees_become_shares_and_the_picture_its_bytes() -> None:
    assert parse_telemetry(telemetry()) == Telemetry(-0.5, 0.25, 9.01, PICTURE, decimal_comma=False)


@pytest.mark.parametrize(
    ("told", "throttle", "speed_mph"),
    [
        ("0.0000", "0.0000", 0.0),
        ("1,234.5000", "0.5000", 1234.5),
        ("1,234,567.2500", "1.0000", 1234567.25),
        ("-0.0100", "0.0000", -0.01),
        ("7.8E-05", "0.0000", 7.8e-5),
        (" 9.5 ", "0.0000", 9.5),
        ("30", "1", 30.0),
        ("9,0100", "0,2500", 9.01),
        ("1.234,5000", "0,0000", 1234.5),
        ("1.234.567,2500", "1,0000", 1234567.25),
        ("1\u00a0234,5000", "0,0000", 1234.5),  # French
        ("1\u202f234,5000", "0,0000", 1234.5),  # French of newer machines
        ("1'234.5000", "0.0000", 1234.5),  # Swiss
        (9.25, 0.25, 9.25),
        (9, 1, 9.0),
    ],
)
def test_numbers_as_every_machine_writes_them(told: object, throttle: object, speed_mph: float) -> None:
    assert parse_telemetry(telemetry(speed=told, throttle=throttle)).speed_mph == pytest.approx(speed_mph)


@pytest.mark.parametrize(("throttle", "comma"), [("0.2500", False), ("0,2500", True), (0.25, False), ("1", False)])
def test_the_throttle_tells_whether_the_machine_writes_commas(throttle: object, comma: bool) -> None:
    assert parse_telemetry(telemetry(throttle=throttle)).decimal_comma is comma


def test_steering_and_throttle_stay_within_their_bounds() -> None:
    for degrees, expected in (("25.0000", 1.0), ("-25.0000", -1.0), ("26", 1.0), ("-1,000.0", -1.0)):
        assert parse_telemetry(telemetry(steering_angle=degrees)).steering == expected
    assert parse_telemetry(telemetry(throttle="1.5")).throttle == 1.0
    assert parse_telemetry(telemetry(throttle="-0.5")).throttle == 0.0


NOT_NUMBERS: tuple[object, ...] = (
    ...,
    None,
    "",
    " ",
    "nan",
    "NaN",
    "inf",
    "-Infinity",
    math.nan,
    math.inf,
    -math.inf,
    10**400,
    "1e999",
)
NOT_NUMBERS += ("fast", "0x1F", "1_000", "1.2.3", "--1", "9" * 64, [9.0], {"value": 9.0}, True, "9\x00")


@pytest.mark.parametrize("speed", [1e300, "-1e8"])
def test_a_speed_that_no_distance_can_be_made_of_is_refused(speed: object) -> None:
    with pytest.raises(TelemetryError, match=r"^speed is beyond"):
        parse_telemetry(telemetry(speed=speed))


@pytest.mark.parametrize("field", ["steering_angle", "throttle", "speed"])
@pytest.mark.parametrize("value", NOT_NUMBERS, ids=lambda value: repr(value)[:12])
def test_what_is_not_a_finite_number_is_refused_by_its_fields_name(field: str, value: object) -> None:
    with pytest.raises(TelemetryError, match=f"^{field} is "):
        parse_telemetry(telemetry(**{field: value}))


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (..., "missing"),
        (None, "missing"),
        ("", "missing"),
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


def test_the_largest_picture_that_is_allowed_is_taken() -> None:
    assert len(parse_telemetry(telemetry(image="A" * MAX_IMAGE_BYTES)).jpeg) == MAX_IMAGE_BYTES * 3 // 4


@pytest.mark.parametrize("data", [None, 1, "telemetry", [telemetry()], b"", True, {}, {"telemetry": telemetry()}])
def test_what_is_not_an_object_with_the_fields_is_refused(data: object) -> None:
    with pytest.raises(TelemetryError):
        parse_telemetry(data)


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
        told = parse_telemetry(data)
    except TelemetryError:
        return
    assert -1 <= told.steering <= 1
    assert 0 <= told.throttle <= 1
    assert math.isfinite(told.speed_mph)


@given(st.floats(-1, 1), st.floats(-1, 1), st.booleans())
def test_a_command_is_two_strings_that_the_clients_culture_reads(
    steering: float, throttle: float, comma: bool
) -> None:
    answer = format_command(steering, throttle, comma)
    assert set(answer) == {"steering_angle", "throttle"}
    for text, value in ((answer["steering_angle"], steering), (answer["throttle"], throttle)):
        assert isinstance(text, str)
        assert ("." in text, "," in text) == (not comma, comma)
        read = float(text.replace(",", "."))  # no thousands separators: 1 at most
        assert read == pytest.approx(value, abs=1e-6)
        assert -1 <= read <= 1
        assert "e" not in text


def test_the_first_throttles_are_those_of_the_formula() -> None:
    """0.1 a mph too slow, and 0.002 a mph summed over the telemetries so far, this one included."""
    controller = SpeedController(9.0)
    assert controller.throttle(4.0) == pytest.approx(0.1 * 5 + 0.002 * 5)
    assert controller.throttle(6.0) == pytest.approx(0.1 * 3 + 0.002 * (5 + 3))
    assert controller.throttle(10.0) == pytest.approx(0.1 * -1 + 0.002 * (5 + 3 - 1))


@pytest.mark.parametrize("telemetries", [1_000, 10_000])
def test_a_long_climb_does_not_wind_up_a_throttle_that_outlasts_it(telemetries: int) -> None:
    controller = SpeedController(10.0)
    for _ in range(telemetries):
        throttle = controller.throttle(2.0)
    assert throttle == 1.0
    # 3 mph too fast takes 0.3 off at once, and 0.006 more with each telemetry, off an integral of at most 0.5
    after = [controller.throttle(13.0) for _ in range(60)]
    assert after[0] <= 0.5 - 0.3
    assert after == sorted(after, reverse=True)
    assert next(i for i, throttle in enumerate(after) if throttle < 0) <= math.ceil(0.2 / 0.006)


def test_a_long_descent_does_not_wind_up_a_brake() -> None:
    controller = SpeedController(10.0)
    for _ in range(10_000):
        controller.throttle(30.0)
    assert next(i for i in range(200) if controller.throttle(7.0) > 0) <= math.ceil(0.2 / 0.006)


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=50), st.floats(0, 100))
def test_the_throttle_stays_within_its_bounds(speeds_mph: list[float], set_speed_mph: float) -> None:
    controller = SpeedController(set_speed_mph)
    assert all(-1 <= controller.throttle(speed_mph) <= 1 for speed_mph in speeds_mph)
