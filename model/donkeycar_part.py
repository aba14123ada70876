"""A part for DonkeyCar's loop that steers with a network of the behavioural-cloning toolkit. It needs only NumPy
and ONNX Runtime, not the toolkit.

`bc-train export RUN --donkeycar FOLDER` writes this file next to the network. Copy both to the car's folder. In
its manage.py, add the part above `aiLauncher = AiLaunch(`:

    from donkeycar_part import OnnxPilot
    V.add(OnnxPilot("NAME.onnx", throttle=0.2), inputs=["cam/image_array"],
          outputs=["pilot/angle", "pilot/throttle"], run_condition="run_pilot")
"""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import onnxruntime

STANDING = (0.0, 0.0)


class OnnxPilot:
    """Answers the camera's picture with steering -1 (left) .. 1 (right) and throttle -1 .. 1.

    `throttle` is constant; None takes the throttle that the network predicts. Inference uses `threads` processor
    threads. Raises ValueError for a file that `--donkeycar` did not write, and if `throttle` is None and the
    network predicts none.
    """

    def __init__(self, network: str | Path, throttle: float | None = None, threads: int = 1) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        self._network = onnxruntime.InferenceSession(str(network), options, providers=["CPUExecutionProvider"])
        if [tensor.name for tensor in self._network.get_inputs()] != ["picture"]:
            raise ValueError(
                f"{network}: not for camera pictures: write it with `bc-train export RUN --donkeycar`"
            )
        predicts_throttle = "throttle" in [tensor.name for tensor in self._network.get_outputs()]
        if throttle is None and not predicts_throttle:
            raise ValueError(
                f"{network} predicts no throttle: give one, as in OnnxPilot({str(network)!r}, throttle=0.2)"
            )
        if throttle is not None and not -1 <= throttle <= 1:
            raise ValueError(f"throttle {throttle}: expected -1 to 1")
        self._throttle = throttle
        self._names = ["steering"] if throttle is not None else ["steering", "throttle"]
        self._answer = STANDING
        self._picture: np.ndarray | None = None
        self._problem: Exception | None = None
        self._is_on = True
        self._has_picture = threading.Event()

    def run(self, picture: np.ndarray | None) -> tuple[float, float]:
        """Steering and throttle for a picture, uint8 (height, width, 3) RGB, or grey (height, width); 0 and 0
        without a picture. Raises ValueError for answers that are not finite."""
        if picture is None:  # before the camera's first picture
            return STANDING
        if picture.ndim == 2 or picture.shape[2] == 1:
            picture = np.repeat(picture.reshape(*picture.shape[:2], 1), 3, axis=2)
        steering, *predicted = (
            float(answer[0]) for answer in self._network.run(self._names, {"picture": picture})
        )
        throttle = predicted[0] if self._throttle is None else self._throttle
        if not np.isfinite([steering, throttle]).all():
            raise ValueError(f"the network answered {steering} and {throttle}")
        return max(-1.0, min(steering, 1.0)), max(-1.0, min(throttle, 1.0))

    def run_threaded(self, picture: np.ndarray | None) -> tuple[float, float]:
        """Hand this picture to `update`, and return its last answer. Raises the error with which `update` failed,
        so that the car stops."""
        if self._problem is not None:
            raise self._problem
        self._picture = picture
        self._has_picture.set()
        return self._answer

    def update(self) -> None:
        """Answer the newest picture until `shutdown`. DonkeyCar runs it in a thread."""
        while self._has_picture.wait() and self._is_on:
            self._has_picture.clear()
            try:
                self._answer = self.run(self._picture)
            except Exception as problem:
                self._problem = problem
                return

    def shutdown(self) -> None:
        """End `update`."""
        self._is_on = False
        self._has_picture.set()
