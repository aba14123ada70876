"""DonkeyCar's own loop drives with a run's network, and a tub that DonkeyCar writes becomes a session.

Skipped unless BC_DONKEYCAR_PYTHON names a Python that has donkeycar 5 and ONNX Runtime (`make donkeycar`).
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pytest

from dataset import decode
from model import load_pilot
from model.onnx_export import export_to_donkeycar
from recorder import Log
from recorder.sources.import_recording import import_recording
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.needs import DONKEYCAR_PYTHON
from tests.helpers.ports import free_ports
from tests.helpers.repository import ROOT

PROGRAM: Final = ROOT / "tests" / "helpers" / "donkeycar_program.py"
ABOVE, LAST = "    aiLauncher = AiLaunch(", "    # run the vehicle\n"
PROBE: Final = """
    import numpy as np
    class Probe:
        rows = []
        def run(self, picture, *numbers):
            self.rows.append((picture, numbers))
        def shutdown(self):
            np.savez("drive.npz", pictures=[row[0] for row in self.rows], numbers=[row[1] for row in self.rows])
    V.add(Probe(), inputs=["cam/image_array", "pilot/angle", "steering", "throttle"])
"""

pytestmark = pytest.mark.needs("donkeycar")


def run_donkeycar(folder: Path, *arguments: object) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    line = [str(DONKEYCAR_PYTHON), *map(str, arguments)]
    done = subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.fixture(scope="module")
def pictures() -> Any:
    """Roads as DonkeyCar's camera would see them: (5, 120, 160, 3), RGB."""
    roads = [decode(road_jpeg(number)) for number in range(0, 25, 5)]
    return np.stack([cv2.resize(road, (160, 120))[..., ::-1] for road in roads])


def steered(run: Path, pictures: Any) -> list[float]:
    """As the toolkit's own pilot steers, between -1 and 1."""
    pilot = load_pilot(run, "float32")
    answers = [pilot.predict(pilot.crop(np.ascontiguousarray(picture[..., ::-1]))) for picture in pictures]
    return [float(answer) for answer in np.clip(answers, -1, 1)]


def test_the_lines_of_the_page_drive_in_its_manage_py(tmp_path: Path, pictures: Any) -> None:
    run = untrained_run(tmp_path / "first", targets=("steering", "throttle"))
    car = tmp_path / "mycar"
    run_donkeycar(tmp_path, "-m", "donkeycar.management.base", "createcar", "--path", car)
    export_to_donkeycar(run, car)
    (lines,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "donkeycar.md").read_text(), re.DOTALL)
    program = (car / "manage.py").read_text()
    assert (program.count(ABOVE), program.count(LAST)) == (1, 1)
    (car / "manage.py").write_text(program.replace(ABOVE, lines + ABOVE).replace(LAST, PROBE + LAST))
    for number, picture in enumerate(pictures):  # PNG: two decoders of JPEG may round differently
        assert cv2.imwrite(str(car / f"{number}_road.png"), picture[..., ::-1])
    (car / "myconfig.py").write_text(
        'CAMERA_TYPE, PATH_MASK, DRIVE_TRAIN_TYPE, WEB_INIT_MODE = "IMAGE_LIST", "*_road.png", "MOCK", "local"\n'
        f"USE_JOYSTICK_AS_DEFAULT, WEB_CONTROL_PORT, MAX_LOOPS = False, {free_ports(1)[0]}, {len(pictures)}\n"
    )
    run_donkeycar(car, "manage.py", "drive")
    with np.load(car / "drive.npz") as drive:
        seen, (angles, steering, throttle) = drive["pictures"], drive["numbers"].T
    assert sorted(map(bytes, seen)) == sorted(map(bytes, pictures))
    np.testing.assert_allclose(angles, steered(run, seen), atol=0.02)
    np.testing.assert_array_equal(steering, angles)
    assert np.std(angles) > 0.01
    assert np.std(throttle) > 0


def test_it_drives_the_simulator_of_donkeycar_in_a_thread_of_its_own(tmp_path: Path, pictures: Any) -> None:
    run = untrained_run(tmp_path / "first")
    network, _ = export_to_donkeycar(run, tmp_path / "car")
    np.savez(tmp_path / "frames.npz", pictures=pictures)
    run_donkeycar(tmp_path, PROGRAM, "simulator", tmp_path / "frames.npz", network, tmp_path / "answers.npz")
    with np.load(tmp_path / "answers.npz") as answers:
        actions, steering = answers["actions"], answers["steering"]
    np.testing.assert_allclose(steering, steered(run, pictures), atol=0.02)
    assert {tuple(action) for action in actions} <= {(0, 0, 0), *((value, 0.3, 0) for value in steering)}
    assert set(steering) <= set(actions[:, 0])


def test_a_tub_that_it_writes_becomes_a_session(tmp_path: Path, pictures: Any) -> None:
    angles, throttles = [-1.0, -0.25, 0.0, 0.5, 1.0], [0.2, 0.3, 0.4, 0.5, -0.1]
    np.savez(tmp_path / "frames.npz", pictures=pictures, angles=angles, throttles=throttles)
    run_donkeycar(tmp_path, PROGRAM, "tub", tmp_path / "frames.npz", tmp_path / "data")
    done = import_recording(tmp_path / "data", tmp_path / "track.mcap")
    assert (done.rows, done.pictures, list(done.skipped)) == (5, 5, [])
    with Log(done.path) as log:
        vehicle = log.vehicle()
        assert vehicle["steering"].to_pylist() == angles
        assert vehicle["throttle"].to_pylist() == [0.2, 0.3, 0.4, 0.5, 0.0]
        for row, picture in enumerate(pictures):
            kept = decode(log.picture(row))
            assert np.abs(kept[..., ::-1].astype(int) - picture).mean() < 8  # JPEG: but red stays red
