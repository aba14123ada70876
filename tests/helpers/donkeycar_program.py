# mypy: ignore-errors
"""Run by a Python that has DonkeyCar: its own tub, its own loop, and its own part for its simulator.

python donkeycar_program.py tub FRAMES.npz FOLDER
python donkeycar_program.py simulator FRAMES.npz NETWORK.onnx ANSWERS.npz    (donkeycar_part.py lies beside it)
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import ModuleType

import numpy as np


def write_tub(frames: Path, folder: Path) -> None:
    from donkeycar.parts.tub_v2 import Tub

    inputs, types = (
        ["cam/image_array", "user/angle", "user/throttle", "user/mode"],
        ["image_array", "float", "float", "str"],
    )
    tub = Tub(str(folder), inputs=inputs, types=types)
    with np.load(frames) as given:
        for picture, angle, throttle in zip(given["pictures"], given["angles"], given["throttles"], strict=True):
            tub.write_record(dict(zip(inputs, (picture, float(angle), float(throttle), "user"), strict=True)))
    tub.close()


class Simulator:
    """A Gym environment in the place of DonkeyCar's simulator: the pictures one after the other, each until an
    action has come that answers it."""

    def __init__(self, pictures: np.ndarray) -> None:
        self.pictures, self.steps, self.actions = pictures, 0, []

    def reset(self) -> np.ndarray:
        return self.pictures[0]

    def step(self, action: list[float]) -> tuple[np.ndarray, float, bool, dict]:
        time.sleep(0.001)
        self.steps += 1
        self.actions.append(list(action))
        return self.pictures[self.steps // 20 % len(self.pictures)], 0.0, False, {}

    def close(self) -> None:
        pass


def drive_simulator(frames: Path, network: Path, answers: Path) -> None:
    with np.load(frames) as given:
        simulator = Simulator(given["pictures"])
    gym = ModuleType("gym")
    gym.make = lambda name, conf: simulator
    sys.modules |= {"gym": gym, "gym_donkeycar": ModuleType("gym_donkeycar")}
    sys.path.insert(0, str(network.parent))
    from donkeycar.parts.dgym import DonkeyGymEnv
    from donkeycar.vehicle import Vehicle
    from donkeycar_part import OnnxPilot

    pilot = OnnxPilot(network, throttle=0.3)
    vehicle = Vehicle()
    vehicle.add(
        DonkeyGymEnv("remote"), inputs=["steering", "throttle"], outputs=["cam/image_array"], threaded=True
    )
    vehicle.add(pilot, inputs=["cam/image_array"], outputs=["steering", "throttle"], threaded=True)
    vehicle.start(rate_hz=200, max_loop_count=200)
    np.savez(
        answers, actions=simulator.actions, steering=[pilot.run(picture)[0] for picture in simulator.pictures]
    )
    (thread,) = [entry["thread"] for entry in vehicle.parts if entry["part"] is pilot]
    thread.join(10)
    assert not thread.is_alive()


if __name__ == "__main__":
    command, *paths = sys.argv[1:]
    {"tub": write_tub, "simulator": drive_simulator}[command](*map(Path, paths))
