"""A driving server as such projects have had it since 2017; needs nothing of this toolkit but its network.

python benchmarks/driving_classic.py PORT WEIGHTS [--network keras|torch]

The pattern of the `drive.py` of Udacity's CarND-Behavioral-Cloning-P3 project and of its many descendants, in own
words: python-socketio 4 on eventlet; PIL reads the picture, `model.predict(picture, batch_size=1)` gives the
steering, a proportional-integral controller holds the speed, `emit("steer", ..., skip_sid=True)` answers, and a
`steer` is also sent when a simulator connects. It spares what they print to the terminal. WEIGHTS is an .npz of
arrays as PyTorch has them, as driving_replies.py writes it.

Needs `pip install python-socketio==4.6.1 python-engineio==3.13.2 eventlet pillow opencv-python-headless`, and
tensorflow-cpu or torch.
"""

from __future__ import annotations

import argparse
import base64
from collections.abc import Callable
from io import BytesIO
from typing import Any, Final

import cv2
import eventlet
import eventlet.wsgi
import numpy as np
import socketio
from numpy.typing import NDArray
from PIL import Image

SET_SPEED_MPH: Final = 9.0

Predict = Callable[[NDArray[np.uint8]], float]
"""Steering for a crop (128, 128, 3), BGR."""


class SpeedController:
    """Proportional-integral, without a bound, as they have it."""

    def __init__(self) -> None:
        self._integral = 0.0

    def update(self, speed_mph: float) -> float:
        error = SET_SPEED_MPH - speed_mph
        self._integral += error
        return 0.1 * error + 0.002 * self._integral


def keras_network(weights: list[NDArray[np.float32]]) -> Predict:
    """The network of training_keras.py, asked by `predict`."""
    from training_keras import network

    model = network()
    arrays = []
    for array in weights:
        if array.ndim == 4:  # (out, in, height, width)
            array = array.transpose(2, 3, 1, 0)
        elif array.ndim == 2:  # (out, in)
            if array.shape[1] == 4096:  # flattened from (64, 8, 8) there, from (8, 8, 64) here
                array = array.reshape(-1, 64, 8, 8).transpose(0, 2, 3, 1).reshape(-1, 4096)
            array = array.T
        arrays.append(array)
    model.set_weights(arrays)
    return lambda crop: float(model.predict(crop[None], batch_size=1, verbose=0)[0, 0])


def torch_network(weights: list[NDArray[np.float32]]) -> Predict:
    """This toolkit's network, asked as one would first write it: float32, contiguous, as many threads as cores."""
    import torch

    from model.network.original import SteeringNetwork

    network = SteeringNetwork().eval()
    names = network.state_dict().keys()
    network.load_state_dict({n: torch.from_numpy(w) for n, w in zip(names, weights, strict=True)})

    def predict(crop: NDArray[np.uint8]) -> float:
        with torch.no_grad():
            return float(network(torch.from_numpy(crop.transpose(2, 0, 1)[None].copy())).item())

    return predict


def serve(port: int, predict: Predict) -> None:
    """Drive whoever connects, until the process is ended."""
    server = socketio.Server()
    controller = SpeedController()

    def send_control(steering: float, throttle: float) -> None:
        command = {"steering_angle": str(steering), "throttle": str(throttle)}
        server.emit("steer", data=command, skip_sid=True)

    @server.on("telemetry")  # type: ignore[untyped-decorator]
    def telemetry(sid: str, data: Any) -> None:
        if data:
            picture = np.asarray(Image.open(BytesIO(base64.b64decode(data["image"]))))
            crop = cv2.cvtColor(cv2.resize(picture[50:-20], (128, 128)), cv2.COLOR_RGB2BGR)
            send_control(predict(np.asarray(crop, np.uint8)), controller.update(float(data["speed"])))
        else:
            server.emit("manual", data={}, skip_sid=True)

    @server.on("connect")  # type: ignore[untyped-decorator]
    def connect(sid: str, environ: dict[str, Any]) -> None:
        send_control(0, 0)

    application = socketio.WSGIApp(server)
    eventlet.wsgi.server(eventlet.listen(("127.0.0.1", port)), application, log_output=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("port", type=int)
    parser.add_argument("weights")
    parser.add_argument("--network", default="keras", choices=["keras", "torch"])
    chosen = parser.parse_args()
    with np.load(chosen.weights, allow_pickle=False) as stored:
        weights = [stored[name] for name in stored.files]
    predict = keras_network(weights) if chosen.network == "keras" else torch_network(weights)
    for _ in range(5):
        predict(np.zeros((128, 128, 3), np.uint8))
    serve(chosen.port, predict)


if __name__ == "__main__":
    main()
