"""What is answered to each telemetry: steering and throttle within their bounds, whatever the simulator tells."""

from __future__ import annotations

import base64
import math
from dataclasses import asdict, replace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dataset import decode
from dataset.prediction_targets import TARGET_NAMES, TARGETS, TargetName
from drive.config import DriveConfig
from drive.control.driver import MAX_PIXELS, Decision, Driver
from drive.control.speed_controller import max_curve_speed_mph
from model import Pilot
from model.network.pilotnet import SmallNetwork
from recorder.server.world import World
from simulator.driving.expert import BEND_MPS2
from simulator.driving.vehicle import STEP_S, CarState, step
from tests.helpers.driving import road_jpeg

MIDDLE = World(0.0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, -0.3, 0.7)
NONSENSE = {"speed": "fast"}


def say(network: SmallNetwork, steering: float) -> SmallNetwork:
    """Every picture gets the same answer from now on."""
    with torch.no_grad():
        network.head[-1].weight.zero_()  # type: ignore[operator]
        network.head[-1].bias.fill_(steering)  # type: ignore[operator]
    return network


def pilot_that_says(steering: float) -> Pilot:
    return Pilot(say(SmallNetwork(), steering))


def untrained_pilot() -> Pilot:
    torch.manual_seed(3)
    return Pilot(SmallNetwork())


@pytest.fixture(scope="module")
def half_right() -> Pilot:
    pilot = pilot_that_says(0.5)
    pilot.warm_up()
    return pilot


@pytest.fixture(scope="module")
def no_number() -> Pilot:
    return pilot_that_says(math.nan)


def message(number: int = 0, speed_mph: float = 9.0, world: World | None = None, **changed: Any) -> dict[str, Any]:
    """A telemetry as the simulator tells it."""
    image = base64.b64encode(road_jpeg(number)).decode()
    fields: dict[str, Any] = {"steering_angle": "0.0000", "throttle": "0.1000", "speed": f"{speed_mph:.4f}"}
    if world is not None:
        fields["world"] = asdict(world)
    return {**fields, "image": image, **changed}


def picture(width: int, height: int, kind: str = ".jpg") -> bytes:
    ok, data = cv2.imencode(kind, np.full((height, width, 3), 90, np.uint8))
    assert ok
    return data.tobytes()


def encoded(width: int, height: int) -> str:
    return base64.b64encode(picture(width, height)).decode()


def drive(driver: Driver, data: object, now_s: float = 0.0) -> Decision:
    return driver.decide(data, received_s=0.0, now_s=now_s)


# What else the network wants


def pilot_that_wants(**wanted: float) -> Pilot:
    """It answers these targets, and steers straight on."""
    names: tuple[TargetName, ...] = ("steering", *(name for name in TARGET_NAMES if name in wanted))
    network = SmallNetwork(outputs=len(names))
    network.outputs = len(names)
    say(network, 0.0)
    with torch.no_grad():
        for at, name in enumerate(names[1:], 1):
            network.head[-1].bias[at] = wanted[name] / TARGETS[name].per_unit  # type: ignore[operator]
    return Pilot(network, targets=names, speed_ahead_s=1.0)


@pytest.mark.parametrize(
    ("wanted_mph", "driven_mph"), [(12.0, 12.0), (50.0, 20.0), (-3.0, 0.0)]
)  # never above the set speed of 20 mph
def test_the_speed_that_the_network_wants_is_driven(wanted_mph: float, driven_mph: float) -> None:
    driver = Driver(pilot_that_wants(speed=wanted_mph), DriveConfig(set_speed_mph=20.0))
    decision = drive(driver, message(speed_mph=16.0))
    assert decision.predicted_speed_mph == pytest.approx(wanted_mph, abs=1e-4)
    assert decision.set_speed_mph == pytest.approx(driven_mph, abs=1e-4)
    assert (decision.throttle > 0) == (driven_mph > 16)


@pytest.mark.parametrize(
    ("speed_mph", "wanted", "sent"),
    [
        (10.0, 0.4, 0.4),
        (10.0, -0.6, -0.6),
        (0.0, -0.6, 0.0),  # at a stand it would go backwards
        (26.0, 1.0, -0.39),  # 6 mph above the set speed: as much brake as takes a second for them, less the drag
    ],
)
def test_the_throttle_that_the_network_wants_is_sent_below_the_set_speed(
    speed_mph: float, wanted: float, sent: float
) -> None:
    driver = Driver(pilot_that_wants(throttle=wanted), DriveConfig(set_speed_mph=20.0))
    decision = drive(driver, message(speed_mph=speed_mph))
    assert decision.throttle == pytest.approx(sent, abs=0.15 if sent == -0.39 else 1e-6)
    assert decision.predicted_throttle == pytest.approx(wanted)


def test_a_network_of_little_throttle_is_kept_to_the_set_speed() -> None:
    """What the car lacked meanwhile it lacked because of the network, not because of a hill."""
    network = say(SmallNetwork(outputs=2), 0.0)
    network.outputs = 2
    pilot, car = Pilot(network, targets=("steering", "throttle")), CarState(0.0, 0.0, 0.0, 8.0)
    driver = Driver(pilot, DriveConfig(set_speed_mph=20.0))
    fastest_mph = 0.0
    for number in range(40):
        with torch.no_grad():
            network.head[-1].bias[1] = 0.2 if number < 10 else 1.0  # type: ignore[operator]
        throttle = drive(driver, message(speed_mph=car.speed_mph), number / 10).throttle
        for _ in range(round(0.1 / STEP_S)):
            car = step(car, 0.0, throttle)
        fastest_mph = max(fastest_mph, car.speed_mph)
    assert 19.5 < fastest_mph < 20.1


def test_a_speed_that_is_no_number_brakes() -> None:
    decision = drive(Driver(pilot_that_wants(speed=math.nan), DriveConfig()), message(speed_mph=10.0))
    assert (decision.driver, decision.problem) == ("brake", "the network gave no number")
    assert decision.throttle < 0


# A telemetry that is driven on


def test_the_answer_is_the_networks_and_what_led_to_it_is_reported() -> None:
    pilot, data = untrained_pilot(), message(7, speed_mph=4.0)
    decision = drive(Driver(pilot, DriveConfig()), data)
    crop = pilot.crop(decode(road_jpeg(7)))
    assert decision.crop is not None
    assert (decision.crop == crop).all()
    assert decision.predicted_steering == decision.steering == pilot.predict(crop)
    assert decision.throttle == pytest.approx(0.1 * 6 + 0.002 * 6)  # the first of the controller, 6 mph too slow
    assert decision.telemetry is not None
    assert decision.telemetry.picture == road_jpeg(7)
    assert (decision.driver, decision.set_speed_mph, decision.problem, decision.events) == ("pilot", 10.0, "", ())
    assert min(decision.parse_ms, decision.decode_ms, decision.network_ms) > 0


@pytest.mark.parametrize(("predicted", "sent"), [(7.0, 1.0), (-1.5, -1.0), (math.inf, 0.0)])
def test_steering_is_clamped_and_the_prediction_is_not(predicted: float, sent: float) -> None:
    decision = drive(Driver(pilot_that_says(predicted), DriveConfig()), message())
    assert (decision.predicted_steering, decision.steering) == (predicted, sent)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (1, 1), (5, 4000)])
def test_a_picture_of_another_size_is_driven_on_and_that_is_said_once(
    half_right: Pilot, width: int, height: int
) -> None:
    driver = Driver(half_right, DriveConfig())
    events: list[str] = []
    for _ in range(3):
        decision = drive(driver, message(image=encoded(width, height)))
        assert (decision.steering, decision.problem) == (0.5, "")
        events += decision.events
    assert events == [f"pictures of {width}x{height} pixels, not 320x160: used nevertheless"]


@pytest.mark.parametrize(
    ("jpeg", "problem"),
    [
        (encoded(2049, 1024), f"image has more than {MAX_PIXELS:,} pixels (2,098,176)"),
        (base64.b64encode(picture(2049, 1024)[:-9]).decode(), f"image has more than {MAX_PIXELS:,} pixels"),
        (base64.b64encode(picture(2049, 1024, ".png")).decode(), f"image has more than {MAX_PIXELS:,} pixels"),
        (base64.b64encode(road_jpeg(0)[:-900]).decode(), "image is a JPEG that is cut off or damaged ("),
        (base64.b64encode(b"\x89PNG" + bytes(99)).decode(), "image is a PNG that is cut off or damaged ("),
        (base64.b64encode(bytes(99)).decode(), "image is not a JPEG or PNG (99 bytes)"),
        ("", "image is empty"),
    ],
)
def test_a_picture_that_is_too_large_or_none_is_not_driven_on(half_right: Pilot, jpeg: str, problem: str) -> None:
    decision = drive(Driver(half_right, DriveConfig()), message(image=jpeg))
    assert problem in decision.problem
    assert (decision.steering, decision.throttle, decision.telemetry, decision.crop) == (0.0, 0.0, None, None)
    assert decision.speed_mph == 9.0  # what can be read is used


def test_commas_are_answered_in_kind_also_after_nonsense(half_right: Pilot) -> None:
    driver = Driver(half_right, DriveConfig())
    comma: dict[str, Any] = {"steering_angle": "-1,0000", "throttle": "0,1000", "speed": "9,0000"}
    assert [
        drive(driver, data).decimal_separator
        for data in (
            NONSENSE,
            message(),
            message(**comma),
            NONSENSE,
            message(**comma, image="AAAA"),
            message(),
            NONSENSE,
        )
    ] == [".", ".", ",", ",", ",", ".", "."]


# Nonsense


def test_nonsense_keeps_the_steering_and_lets_go_of_the_throttle(half_right: Pilot) -> None:
    driver = Driver(half_right, DriveConfig())
    drive(driver, message(), 0.0)
    for now_s in (0.1, 0.5, 1.0):
        decision = drive(driver, NONSENSE, now_s)
        assert (decision.steering, decision.throttle, decision.telemetry) == (0.5, 0.0, None)
        assert (decision.kind, decision.events) == ("steering_angle, throttle and image are missing", ())


def test_a_simulators_clock_that_stands_puts_off_no_brake_and_no_release(half_right: Pilot) -> None:
    """Also one that stands from the first nonsense on; the second is this computer's then."""
    nonsense = message(image="@@", speed_mph=20.0, world=World(0.0))
    for good in (0, 20):
        driver = Driver(half_right, DriveConfig())
        for k in range(good):
            drive(driver, message(speed_mph=20.0, world=replace(MIDDLE, time_s=0.0)), k / 20)
        throttles = [drive(driver, nonsense, (good + k) / 20).throttle for k in range(100)]
        assert throttles[:19] == [0.0] * 19
        assert throttles[21] == -1.0
        assert throttles[-1] == 0.0
        assert 1.0 < throttles.count(-1.0) / 20 < 2.5


@pytest.mark.parametrize("step_s", [0.0, -0.1])
def test_a_clock_that_does_not_advance_is_not_used_and_that_is_said_once(half_right: Pilot, step_s: float) -> None:
    driver = Driver(half_right, DriveConfig(max_steering_per_s=0.1))
    decisions = [
        drive(driver, message(world=replace(MIDDLE, time_s=9 + k * step_s)), 5 + k / 20) for k in range(60)
    ]
    events = [(k, event) for k, decision in enumerate(decisions) for event in decision.events]
    text = "time_s does not advance: this computer's clock counts instead"
    assert [event for _, event in events] == [f"the simulator's world is not used whole: {text}"]
    assert 1.0 <= events[0][0] / 20 <= 1.1
    assert decisions[-1].steering - decisions[-21].steering == pytest.approx(0.1)


def test_good_telemetry_in_between_is_driven_and_begins_the_second_again(half_right: Pilot) -> None:
    driver = Driver(half_right, DriveConfig())
    answers = [drive(driver, NONSENSE if k % 2 else message(), 0.6 * k) for k in range(20)]
    assert [answer.throttle > 0 for answer in answers] == [True, False] * 10
    assert all(answer.throttle == 0.0 for answer in answers[1::2])


@pytest.mark.parametrize("data", [NONSENSE, None, message(image="AAAA", speed_mph=30.0)])
@pytest.mark.parametrize("speed_mph", [0.5, 30.0])
def test_after_a_second_of_nonsense_the_car_stops_and_is_not_reversed(
    half_right: Pilot, speed_mph: float, data: object
) -> None:
    """By the built-in simulator's car, which brakes and reverses as the real one's: it acts on every answer until
    the next."""
    driver = Driver(half_right, DriveConfig())
    drive(driver, message(speed_mph=speed_mph), 0.0)
    car = CarState(0.0, 0.0, 0.0, speed_mps=speed_mph * 0.44704)
    throttles: list[float] = []
    events: list[str] = []
    backwards_mps = 0.0
    for k in range(1, 400):
        decision = drive(driver, data, k * 2 * STEP_S)
        for _ in range(2):
            car = step(car, decision.steering, decision.throttle)
            backwards_mps = min(backwards_mps, car.speed_mps)
        throttles.append(decision.throttle)
        events += decision.events
    braked = [k for k, throttle in enumerate(throttles) if throttle < 0]
    assert throttles[-1] == 0.0
    assert {throttles[k] for k in braked} <= {-1.0}
    if data == NONSENSE:
        assert car.speed_mps < 0.2
        assert backwards_mps > -0.2
    assert len(braked) * 2 * STEP_S < 2.0
    assert min(braked, default=25) * 2 * STEP_S == pytest.approx(1.0, abs=3 * STEP_S)
    stands = speed_mph < 1 and data in (NONSENSE, None)
    assert events == [f"nothing usable for 1 s: the car {'stands' if stands else 'is braked'}"]


@pytest.mark.parametrize(("speed_mph", "slope"), [(0.0, 0.0), (5.0, 0.0), (30.0, -0.1)])
@pytest.mark.parametrize("image", ["%%%", ...])
def test_a_car_of_which_only_the_speed_is_readable_is_braked(
    half_right: Pilot, speed_mph: float, image: object, slope: float
) -> None:
    """From the first telemetry on, also downhill, and as the real simulator tells it: without a sign."""
    driver = Driver(half_right, DriveConfig())
    car = CarState(0.0, 0.0, 0.0, speed_mps=speed_mph * 0.44704)
    throttles: list[float] = []
    for k in range(150):
        data = message(speed_mph=abs(car.speed_mph), image=image)
        if image is ...:
            del data["image"]
        decision = drive(driver, data, k * 2 * STEP_S)
        throttles.append(decision.throttle)
        for _ in range(2):
            car = step(car, decision.steering, decision.throttle, slope if throttles.count(-1.0) else 0.0)
        if throttles.count(-1.0) and decision.throttle == 0.0:
            break
    assert (-1.0 in throttles) == (speed_mph > 1.0)
    assert abs(car.speed_mph) < 2.0


@pytest.mark.parametrize("speed_mph", [0.0, 30.0])
def test_a_car_without_a_speed_is_braked_once_and_never_reversed(half_right: Pilot, speed_mph: float) -> None:
    driver = Driver(half_right, DriveConfig())
    car = CarState(0.0, 0.0, 0.0, speed_mps=speed_mph * 0.44704)
    throttles, events = [], list[str]()
    for k in range(1500):
        decision = drive(driver, NONSENSE, k * 2 * STEP_S)
        throttles.append(decision.throttle)
        events += decision.events
        for _ in range(2):
            car = step(car, decision.steering, decision.throttle)
    assert events == [
        "nothing usable for 1 s: the car is braked as from its top speed, because its speed is unknown"
    ]
    assert 1.5 < throttles.count(-1.0) * 2 * STEP_S < 2.5
    assert throttles[:25] == [0.0] * 25
    assert throttles[-1] == 0.0
    assert abs(car.speed_mph) < 1.0


@pytest.mark.parametrize(("speed_mph", "throttle"), [(0.5, 0.0), (5.0, -1.0)])
def test_a_brake_of_unknown_speed_heeds_the_first_speed_that_is_reported(
    half_right: Pilot, speed_mph: float, throttle: float
) -> None:
    driver = Driver(half_right, DriveConfig())
    for k in range(12):
        drive(driver, NONSENSE, k / 10)
    assert drive(driver, message(speed_mph=speed_mph, image="%%%"), 1.2).throttle == throttle
    assert drive(driver, message(speed_mph=0.0, image="%%%"), 1.3).throttle == 0.0
    assert drive(driver, message(speed_mph=5.0, image="%%%"), 1.4).throttle == 0.0  # backwards, perhaps


@pytest.mark.parametrize("data", [message(speed_mph=9.0), message(speed_mph=9.0, image="%%%"), NONSENSE])
def test_at_the_end_the_car_is_braked_and_the_throttle_is_not_the_pilots(half_right: Pilot, data: object) -> None:
    driver = Driver(half_right, DriveConfig())
    drive(driver, message(), 0.0)
    driver.stop()
    decision = drive(driver, data, 0.1)
    assert (decision.steering, decision.throttle, decision.driver) == (0.5, -1.0, "brake")
    assert drive(driver, data, 10.0).throttle == 0.0


def test_a_braked_car_drives_again_as_soon_as_a_telemetry_is_usable(half_right: Pilot) -> None:
    driver = Driver(half_right, DriveConfig())
    drive(driver, message(), 0.0)
    for k in range(30):
        drive(driver, NONSENSE, k / 10)
    decision = drive(driver, message(speed_mph=0.0), 3.1)
    assert (decision.steering, decision.events) == (0.5, ("the brakes are released",))
    assert decision.throttle > 0


def test_a_network_without_a_number_brakes_at_once_and_is_named_once(no_number: Pilot) -> None:
    driver = Driver(no_number, DriveConfig())
    answers = [drive(driver, message(speed_mph=max(0.0, 10 - k)), k / 10) for k in range(15)]
    assert {(answer.steering, answer.problem) for answer in answers} == {(0.0, "the network gave no number")}
    assert answers[0].throttle == -1.0
    assert answers[-1].throttle == 0.0
    assert [event for answer in answers for event in answer.events] == [
        "the network gave no number",
        "the car is braked",
    ]
    assert all(answer.telemetry is not None and answer.crop is not None for answer in answers)  # to be looked into
    assert all(math.isnan(answer.predicted_steering) for answer in answers)


def test_a_standing_car_is_never_reported_to_reverse(no_number: Pilot, half_right: Pilot) -> None:
    """The real simulator's speed has no sign: a car that rolls backwards tells 5 mph too."""
    driver = Driver(no_number, DriveConfig())
    throttles = [
        drive(driver, message(speed_mph=speed), k / 10).throttle for k, speed in enumerate([0.0, 5.0, 5.0])
    ]
    assert throttles == [0.0, 0.0, 0.0]
    driver = Driver(no_number, DriveConfig())  # stopped sooner than was thought, on a hill
    throttles = [
        drive(driver, message(speed_mph=speed), k / 10).throttle for k, speed in enumerate([10.0, 0.5, 5.0])
    ]
    assert throttles == [-1.0, 0.0, 0.0]
    driver = Driver(half_right, DriveConfig(set_speed_mph=1.0))
    for k in range(20):  # far too fast for long: all that the controller remembers says "brake"
        drive(driver, message(speed_mph=30.0), k / 10)
    assert drive(driver, message(speed_mph=0.5), 2.0).throttle == 0.0


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.binary(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
GOOD = {
    "steering_angle": st.sampled_from(["0.0000", "25,0000", "-1,234.5000"]) | st.floats(),
    "throttle": st.sampled_from(["0.1000", "0,1000", 1]) | st.floats(),
    "speed": st.sampled_from(["9.0000", "1 234,5", 0, -30.0]) | st.floats(),
    "image": st.builds(
        lambda number, cut, splice: base64.b64encode(road_jpeg(number)[:cut] + splice).decode(),
        st.integers(0, 3),
        st.sampled_from([None, None, 700, -2]),
        st.binary(max_size=9),
    )
    | st.builds(encoded, st.integers(1, 40), st.integers(1, 40)),
    "world": st.fixed_dictionaries(
        {name: st.sampled_from([0, 1, -0.95, 3.5]) | st.floats() | st.integers() for name in asdict(MIDDLE)}
    ),
}
telemetries = json_like | st.fixed_dictionaries(
    {}, optional={name: good | json_like for name, good in GOOD.items()}
)
configs = st.builds(
    DriveConfig,
    st.floats(0, 100, exclude_min=True),
    st.booleans(),
    st.floats(0, 1e300),
    st.floats(0, 1e300),
    st.booleans(),
)


@given(st.lists(st.tuples(telemetries, st.floats(-1e9, 1e9)), min_size=1, max_size=6), configs)
def test_whatever_is_reported_is_answered_by_numbers_within_their_bounds(
    half_right: Pilot, data: list[tuple[object, float]], config: DriveConfig
) -> None:
    driver = Driver(half_right, config)
    for telemetry, now_s in data:
        decision = drive(driver, telemetry, now_s)
        assert -1 <= decision.steering <= 1
        assert -1 <= decision.throttle <= 1
        assert (decision.telemetry is None) == (decision.crop is None)
        assert bool(decision.problem) == (decision.telemetry is None)


# Smoother, slower


def sent(pilot: Pilot, config: DriveConfig, rate_hz: float, seconds: float) -> list[float]:
    driver = Driver(pilot, config)
    return [drive(driver, message(), 100 + k / rate_hz).steering for k in range(round(seconds * rate_hz) + 1)]


@pytest.mark.parametrize("rate_hz", [5, 25])
def test_smoothing_depends_on_time_and_not_on_the_telemetries(half_right: Pilot, rate_hz: float) -> None:
    steering = sent(half_right, DriveConfig(smooth_s=0.4), rate_hz, 1.2)
    assert steering[0] == 0.0
    assert steering == sorted(steering)
    assert steering[-1] == pytest.approx(0.5 * (1 - math.exp(-3)))  # after three time constants


@pytest.mark.parametrize("rate_hz", [5, 25])
def test_the_rate_of_the_steering_is_bounded(half_right: Pilot, rate_hz: float) -> None:
    steering = sent(half_right, DriveConfig(max_steering_per_s=1.0), rate_hz, 0.8)
    assert steering == pytest.approx([min(0.5, k / rate_hz) for k in range(len(steering))])
    assert steering[-1] == 0.5


@pytest.mark.parametrize("telemetries", [8, 30])
def test_while_nothing_usable_comes_no_change_of_steering_is_saved_up(half_right: Pilot, telemetries: int) -> None:
    driver = Driver(half_right, DriveConfig(max_steering_per_s=0.1))
    for k in range(telemetries):
        drive(driver, NONSENSE, k / 10)
    assert drive(driver, message(), telemetries / 10).steering == pytest.approx(0.01)


def test_the_simulators_own_clock_counts_where_it_sends_it(half_right: Pilot) -> None:
    """A tenth of a second passes there, however long our computer takes; and a clock that goes back is no time."""
    driver = Driver(half_right, DriveConfig(max_steering_per_s=1.0))
    times_s = [5.0, 5.1, 5.1, 5.2, 1.0, 1.1]
    steering = [
        drive(driver, message(world=replace(MIDDLE, time_s=time_s)), 1000.0 * k).steering
        for k, time_s in enumerate(times_s)
    ]
    assert steering == pytest.approx([0.0, 0.1, 0.1, 0.2, 0.2, 0.3])


@pytest.mark.parametrize("steering", [0.05, -0.4, 1.0])
def test_in_curves_the_car_drifts_outwards_as_the_expert_allows(steering: float) -> None:
    """By the simulator's own car, held at the speed and the steering until it has settled."""
    speed_mph = min(max_curve_speed_mph(steering), 100.0)
    car = CarState(0.0, 0.0, 0.0)
    for _ in range(100):
        car = step(replace(car, speed_mps=speed_mph * 0.44704), steering, 0.0)
    assert 0.7 * BEND_MPS2 < abs(car.lateral_mps2) <= BEND_MPS2


def test_the_set_speed_is_lowered_in_curves_if_asked_for(half_right: Pilot) -> None:
    fast = DriveConfig(set_speed_mph=25.0)
    slow = replace(fast, slow_in_curves=True)
    data = message(speed_mph=15.0)
    unhindered, slowed = drive(Driver(half_right, fast), data), drive(Driver(half_right, slow), data)
    straight = drive(Driver(pilot_that_says(0.0), slow), data)
    assert (unhindered.set_speed_mph, straight.set_speed_mph) == (25.0, 25.0)
    assert slowed.set_speed_mph == pytest.approx(max_curve_speed_mph(0.5))
    assert slowed.set_speed_mph < 15.0
    assert slowed.throttle < 0 < unhindered.throttle == straight.throttle


# Who drives


def test_the_experts_commands_are_sent_and_the_networks_are_logged(
    half_right: Pilot,
) -> None:
    driver = Driver(half_right, DriveConfig(takeover=True, max_steering_per_s=1.0))
    decisions = [
        drive(driver, message(world=replace(MIDDLE, time_s=k / 25, offset=0.95 if k == 1 else 0.0)))
        for k in range(3)
    ]
    assert [decision.driver for decision in decisions] == ["pilot", "expert", "expert"]
    assert [(decision.steering, decision.throttle) for decision in decisions[1:]] == [(-0.3, 0.7)] * 2
    assert {decision.predicted_steering for decision in decisions} == {0.5}
    assert decisions[1].events == ("the expert takes over: 0.95 of the half width, and moving off to the left",)
    assert decisions[1].telemetry is not None
    assert decisions[1].telemetry.world is not None
    assert decisions[1].telemetry.world.expert_steering == -0.3


def test_the_pilot_goes_on_from_where_the_expert_has_steered() -> None:
    driver = Driver(pilot_that_says(-0.25), DriveConfig(takeover=True, max_steering_per_s=0.1))
    decisions = [
        drive(driver, message(world=replace(MIDDLE, time_s=k / 10, offset=0.0 if k else 0.95))) for k in range(13)
    ]
    at = next(k for k, decision in enumerate(decisions) if decision.driver == "pilot")
    assert decisions[at - 1].steering == -0.3
    assert decisions[at].events == ("the pilot drives again",)
    assert decisions[at].steering == pytest.approx(-0.29)


def test_without_takeover_the_expert_never_drives_but_is_logged(half_right: Pilot) -> None:
    driver = Driver(half_right, DriveConfig())
    worlds = [
        replace(MIDDLE, offset=0.99, laps=0.9),
        replace(MIDDLE, offset=0.0, laps=0.9, interventions=1),
        replace(MIDDLE, offset=0.99, laps=1.1, interventions=1),
    ]
    decisions = [drive(driver, message(world=world)) for world in worlds]
    assert {decision.driver for decision in decisions} == {"pilot"}
    assert [decision.events for decision in decisions] == [
        (),
        ("off the road, or stuck: the simulator put the car back",),
        ("lap 1",),
    ]
