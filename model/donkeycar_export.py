"""Export a run to a DonkeyCar: an ONNX file that takes the camera's picture, and the part that drives with it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from common import atomic_file
from common.files import refuse_existing
from model.onnx_export import export_onnx
from model.runs.run_files import run_write_errors
from model.runs.run_folder import run_name

PART: Final = Path(__file__).with_name("donkeycar_part.py")


def export_to_donkeycar(run: Path, folder: Path, *, overwrite: bool = False) -> tuple[Path, float]:
    """Write NAME.onnx and donkeycar_part.py to `folder`, which may exist. Returns the path of the ONNX file, and
    the largest difference of the steering between ONNX Runtime and PyTorch.

    An equal donkeycar_part.py stays. Raises RunError as `export_onnx` does; UserError if the ONNX file or a
    different donkeycar_part.py exists and `overwrite` is off.
    """
    code, part = PART.read_bytes(), folder / PART.name
    is_current = part.is_file() and part.read_bytes() == code
    if not is_current:
        refuse_existing(part, overwrite)
    path = folder / f"{run_name(run)}.onnx"
    difference = export_onnx(run, path, of_camera=True, overwrite=overwrite)
    if not is_current:
        with run_write_errors(part), atomic_file(part, overwrite=overwrite) as temporary:
            temporary.write_bytes(code)
    return path, difference
