"""The examples do what their page says."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from threading import Event, Thread
from typing import Any

import foxglove
import numpy as np
import pytest
from foxglove.websocket import ChannelView, Client, ServerListener
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

import own_robot
import own_training
from drive import drive_session
from drive.config import DriveConfig
from drive.drive_server import DriveServer
from foxglove_and_rerun import channels_of, play_to_foxglove, show_in_rerun
from model import load_pilot
from model.cli import main as bc_train
from model.network.own_code import load_code
from own_simulator import MAX_DEG, Car
from recorder import Log
from recorder.log.session_car import Car as Settings
from recorder.log.session_car import max_steering_deg_of, named_car, stored_car
from recorder.server import in_flight
from recorder.topics import POSE
from recorder.upkeep.check import check
from simulator import SimulatorClient, SimulatorTelemetry
from steering_over_time import steering_over_time
from tests.helpers.driving import DriveProcess, Process, command, untrained_run
from tests.helpers.logs import read_messages, write_log
from tests.helpers.repository import ROOT
from tests.helpers.rrd import arrived, contents
from tests.helpers.toy import STEERING, road, toy_index
from tests.helpers.udacity import call
from tests.helpers.waiting import PATIENCE_S, wait_until

TELEMETRIES = 40
SETTINGS = ROOT / "examples" / "own_simulator.toml"


def test_an_example_is_short_and_linked_from_its_page() -> None:
    for example in sorted((ROOT / "examples").glob("*.py")):
        code = example.read_text(encoding="utf-8")
        assert code.count("\n") <= 60, example
        pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
        assert f"\n[examples/{example.name}](../examples/{example.name})\n" in pages, (
            example
        )  # the site shows its code


def drive_car(port: int) -> Car:
    car = Car(TELEMETRIES)
    lock_step(port).run(car.next_telemetry)
    return car


def lock_step(port: int) -> SimulatorClient:
    return SimulatorClient(port=port, wait_s=PATIENCE_S, max_steering_deg=MAX_DEG, in_flight=1)


def test_ones_own_simulator_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "mine.mcap"
    flags = ("--port", 0, "--sessions", tmp_path, "--car", SETTINGS)
    with Process(command("bc-record", "listen", "mine", *flags)) as process:
        car = drive_car(int(process.wait_for(r"waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]))
        assert process.end() == 0
    with Log(path) as log:
        steering = log.vehicle()["steering"].to_pylist()
        assert stored_car(log) == named_car(str(SETTINGS))
        assert max_steering_deg_of(log) == MAX_DEG
        assert log.counts["/camera/center"] == log.counts["/vehicle"] == log.counts[POSE] == TELEMETRIES
    assert abs(steering[-1] - car.telemetry().steering) < 0.1  # 1 is its full lock, not Udacity's
    world = car.telemetry().world
    assert world is not None
    assert abs(world["offset"]) < 0.2  # its own driver keeps to the road


def test_ones_own_simulator_is_driven(tmp_path: Path) -> None:
    run = untrained_run(tmp_path / "run")
    with DriveProcess(run, tmp_path / "run.mcap", "--car", SETTINGS) as process:
        drive_car(process.wait_until_it_listens())
        assert process.end() == 0
    with Log(tmp_path / "run.mcap") as log:
        assert stored_car(log) == Settings(max_steering_deg=MAX_DEG, wheelbase_m=2.6)
        driven = log.vehicle()["steering"].to_pylist()
        sent = [command.steering for _, command in log.commands()]
        np.testing.assert_allclose(driven[1:], sent[:-1], atol=1e-4)  # each answer takes hold at once
        assert log.counts["/pilot/command"] == TELEMETRIES


def test_pauses_make_ones_own_simulator_act_no_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It pauses three times, until it is sent a steer that answers nothing: all the same, each row is steered by
    the answer to the one before."""
    monkeypatch.setattr(drive_session, "WATCHDOG_S", 0.3)
    for name in ("MIN_HOLD_S", "MAX_HOLD_S"):  # others may have the processor meanwhile
        monkeypatch.setattr(in_flight, name, PATIENCE_S)
    pilot, log = load_pilot(untrained_run(tmp_path / "run")), tmp_path / "run.mcap"
    car, over = Car(TELEMETRIES), Event()

    def next_telemetry(command: Any) -> SimulatorTelemetry | None:
        if car.left in (10, 20, 30):
            pushes = server.session.summary.pushes
            wait_until(lambda: server.session.summary.pushes > pushes)
        return car.next_telemetry(command)

    with DriveServer(pilot, DriveConfig(car=named_car(str(SETTINGS))), log, port=0) as server:
        serving = Thread(target=server.run, args=(over.is_set,))
        serving.start()
        lock_step(server.port).run(next_telemetry)
        over.set()
        serving.join(PATIENCE_S)
    with Log(log) as drive:
        vehicle = drive.vehicle()
        steering = dict(zip(vehicle["row"].to_pylist(), vehicle["steering"].to_pylist(), strict=True))
        commands = list(drive.commands())  # rows that were left unanswered have none
    driven = [steering[message.sequence] for message, _ in commands]
    sent = [command.steering for _, command in commands]
    assert {command.in_flight for _, command in commands} == {1}
    np.testing.assert_allclose(driven[1:], sent[:-1], atol=1e-4)


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return toy_index(tmp_path_factory.mktemp("toy"))


def test_steering_over_time(tmp_path: Path) -> None:
    steering = [0.0, 0.1, -0.2, 0.3, 0.4]
    log = write_log(tmp_path / "a.mcap", steering)
    table = steering_over_time(str(log), every="300ms")
    assert table.index.tolist() == [0.0, 0.3]
    assert table.rows.tolist() == [3, 2]
    np.testing.assert_allclose(table.mean_deg, [25 * -0.1 / 3, 25 * 0.35])
    np.testing.assert_allclose(table.leftmost_deg, [-5.0, 7.5])
    np.testing.assert_allclose(table.turned_deg, [25 * 0.4, 25 * 0.6])


def test_a_training_of_ones_own(
    index: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(own_training, "EPOCHS", 6)
    monkeypatch.setattr(own_training, "BATCH", 8)
    own_training.main(str(index))
    first, *epochs = capsys.readouterr().out.splitlines()
    zero, last = (float(re.findall(r"RMSE ([\d.]+)", line)[0]) for line in (first, epochs[-1]))
    assert last < 0.7 * zero < 25 * max(STEERING)
    assert len(epochs) == 6


def test_a_network_of_ones_own(index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = f"{ROOT / 'examples' / 'own_network.py'}:ColumnNet"
    flags = ("--epochs", 1, "--batch", 8, "--network-args", "planes=4", "--index", index, "--runs", tmp_path)
    assert call(bc_train, "--name", "mine", "--network", code, *flags) == 0
    copy = tmp_path / "mine" / "network.py"
    assert f" --network {copy}:ColumnNet`" in capsys.readouterr().out  # the next command, as it can be typed
    load_code(code)
    pilot = load_pilot(tmp_path / "mine")
    assert pilot.crop(np.zeros((160, 320, 3), np.uint8)).shape == (48, 160, 3)


def test_a_log_of_ones_own_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_robot, "ROWS", 8)
    own_robot.main(tmp_path / "robot.mcap")
    assert not check(tmp_path / "robot.mcap").findings
    with Log(tmp_path / "robot.mcap") as log:
        rows = log.vehicle()
        assert log.counts == {"/camera/center": 8, "/vehicle": 8, "/events": 1}
        assert log.metadata["source"] == "my robot"
    np.testing.assert_allclose(rows["steering"], np.sin(np.arange(1, 9) / 15))
    assert set(np.diff(rows["log_time_ns"])) == {50_000_000}


class Subscribed(ServerListener):
    """Which topics somebody wants."""

    def __init__(self) -> None:
        self.topics: set[str] = set()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self.topics.add(channel.topic)


def test_foxglove_is_sent_every_message_as_it_is(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", STEERING[:3], road)
    messages = read_messages(path)
    channels, listener = channels_of(path), Subscribed()
    received: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in messages}
    server = foxglove.start_server(port=0, server_listener=listener)
    try:
        url = f"ws://127.0.0.1:{server.port}"
        with connect(url, subprotocols=[Subprotocol("foxglove.sdk.v1")], open_timeout=PATIENCE_S) as client:
            reported = {message["id"]: message for message in advertised(client, len(channels))}
            wanted = [{"id": number, "channelId": number} for number in reported]
            client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            wait_until(lambda: listener.topics == set(messages))
            play_to_foxglove(path, channels, speed=1e9)
            for _ in range(sum(map(len, messages.values()))):
                content = client.recv(PATIENCE_S)
                assert isinstance(content, bytes)
                number, time_ns = struct.unpack_from("<xIQ", content)  # Foxglove's protocol: its message data
                received[reported[number]["topic"]].append((time_ns, content[13:]))
    finally:
        server.stop()
    assert received == {
        topic: [(message.log_time, message.data) for message, _ in sent] for topic, sent in messages.items()
    }
    assert {message["schemaName"] for message in reported.values()} == {
        "bc.VehicleState",
        "foxglove.CompressedImage",
    }


def advertised(client: ClientConnection, count: int) -> list[dict[str, Any]]:
    """The topics that a server tells of when somebody has connected."""
    channels: list[dict[str, Any]] = []
    while len(channels) < count:
        reported = json.loads(client.recv(PATIENCE_S))
        channels += reported["channels"] if reported["op"] == "advertise" else []
    return channels


def test_rerun_reads_the_same_log_by_itself(tmp_path: Path) -> None:
    path, rrd = write_log(tmp_path / "a.mcap", STEERING[:3], road), tmp_path / "a.rrd"
    show_in_rerun(path, str(rrd))
    wait_until(lambda: arrived(rrd, "/camera/center", "EncodedImage:blob") == 3)
    entities = contents(rrd)
    with Log(path) as log:
        for row, (blob,) in enumerate(entities["/camera/center"]["EncodedImage:blob"]):
            assert bytes(blob) == log.picture(row)
