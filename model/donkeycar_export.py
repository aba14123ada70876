"""A run for a DonkeyCar: its network as an ONNX file that takes the camera's picture, and the part that drives."""

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
    """Write NAME.onnx and donkeycar_part.py to `folder`, which may exist. The network's path, and the largest
    difference of its steering between ONNX Runtime and PyTorch.

    A part of this version stays as it is. Raises RunError as `export_onnx` does; UserError if the network, or
    another part, exists already and `overwrite` is off.
    """
    code, part = PART.read_bytes(), folder / PART.name
    is_written = part.is_file() and part.read_bytes() == code
    if not is_written:
        refuse_existing(part, overwrite)
    path = folder / f"{run_name(run)}.onnx"
    difference = export_onnx(run, path, of_camera=True, overwrite=overwrite)
    if not is_written:
        with run_write_errors(part), atomic_file(part, overwrite=overwrite) as written:
            written.write_bytes(code)
    return path, difference
