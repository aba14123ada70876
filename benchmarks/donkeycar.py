"""How long DonkeyCar's part takes for a picture of 160 x 120, on one thread, with each network: processor time.

python benchmarks/donkeycar.py
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from model.donkeycar_part import OnnxPilot
from model.network.choice import built_in
from model.network.names import BUILT_IN
from model.onnx_export import export_onnx
from model.runs.run_folder import create_run, save_weights

PICTURES = 500


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    picture = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        for name in BUILT_IN:
            choice = built_in(name, {})
            run, path = Path(folder, name), Path(folder, f"{name}.onnx")
            create_run(run, {"network": choice.description}, choice.picture)
            save_weights(run, choice.build().state_dict(), epoch=0)
            export_onnx(run, path, of_camera=True)
            pilot = OnnxPilot(path, throttle=0.2)
            pilot.run(picture)
            times_ms = []
            for _ in range(PICTURES):
                begun = time.thread_time()
                pilot.run(picture)
                times_ms.append(1000 * (time.thread_time() - begun))
            median, slow = np.quantile(times_ms, (0.5, 0.99))
            print(f"{name}: {median:.2f} ms, 99 % within {slow:.2f}; {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
