"""`bc-train export`: write a run as a file for other programs, or as a folder for the Hugging Face hub."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.command import DONE, warn
from common.errors import UsageError
from common.output import print_message, print_next, print_result
from model.runs.run_files import RUNS


@dataclass(frozen=True)
class Export:
    """Export a run's network: as an ONNX file, for a DonkeyCar, or as a folder for the Hugging Face hub."""

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """The run, by name or folder."""
    onnx: Annotated[tuple[()] | tuple[Path] | None, tyro.conf.arg(metavar="[FILE]")] = None
    """Write an ONNX file; by default NAME.onnx in the run's folder."""
    donkeycar: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Write NAME.onnx and donkeycar_part.py to this folder, for DonkeyCar's loop."""
    hub: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Write a new folder for the hub; upload nothing."""
    license: str | None = None
    """Licence on the hub's card, such as mit or cc-by-4.0."""
    network: str | None = None
    """Your network's code: FILE.py:CLASS or MODULE:CLASS."""
    runs: Path = RUNS
    """The runs."""
    force: bool = False
    """Replace an existing file."""


def export(config: Export) -> int:
    _refuse_contradictions(config)
    from model.runs.run_folder import find_run, load_named

    run = find_run(config.run, config.runs)
    load_named([config.network], [run])
    if config.hub is not None:
        return _export_to_hub(run, config.hub, config.license)
    if config.donkeycar is not None:
        return _export_to_donkeycar(run, config.donkeycar, overwrite=config.force)
    return _export_onnx(run, config)


def _refuse_contradictions(config: Export) -> None:
    """Raise UsageError for flags that do not go together."""
    if [config.onnx, config.donkeycar, config.hub].count(None) != 2:
        raise UsageError(
            "give one of --onnx for a file, --donkeycar FOLDER for a DonkeyCar, and --hub FOLDER for the hub"
        )
    if config.hub is None and config.license is not None:
        raise UsageError("--license is only for a folder for the hub: give --hub FOLDER as well")
    if config.hub is not None and config.force:
        raise UsageError("--force is only for a file: a folder is never replaced")


def _export_onnx(run: Path, config: Export) -> int:
    from model.onnx_export import example, export_onnx, input_line
    from model.runs.run_folder import picture_of_run, run_name

    path = config.onnx[0] if config.onnx else run / f"{run_name(run)}.onnx"
    difference = export_onnx(run, path, overwrite=config.force)
    picture = picture_of_run(run)
    print_result(_written(path, difference), f"input {input_line(picture)}")
    print_message("to run it with only onnxruntime and opencv-python-headless:")
    _print_code(example(picture, json.dumps(str(path)), '"picture.jpg"'))
    print_next("python -m pip install onnxruntime opencv-python-headless", "on the machine that runs it")
    return DONE


def _export_to_donkeycar(run: Path, folder: Path, *, overwrite: bool) -> int:
    from model.onnx_export import PART, export_to_donkeycar, input_line
    from model.runs.run_folder import picture_of_run, targets_of_run

    path, difference = export_to_donkeycar(run, folder, overwrite=overwrite)
    print_result(_written(path, difference), f"input {input_line(picture_of_run(run), of_camera=True)}")
    print_message("on the car, `env/bin/pip install onnxruntime`")
    print_message("add to its manage.py, above `aiLauncher = AiLaunch(` (docs/donkeycar.md):")
    throttle = "" if "throttle" in targets_of_run(run) else ", throttle=0.2"
    _print_code(
        "    from donkeycar_part import OnnxPilot\n"
        f'    V.add(OnnxPilot({json.dumps(path.name)}{throttle}), inputs=["cam/image_array"],\n'
        '          outputs=["pilot/angle", "pilot/throttle"], run_condition="run_pilot")\n'
    )
    files = shlex.join(map(str, (path, folder / PART.name)))
    print_next(f"scp {files} pi@donkeypi.local:mycar/", "to copy both files to the car")
    return DONE


def _written(path: Path, difference: float) -> str:
    return f"{path}: written; steering in ONNX Runtime and in PyTorch: largest difference {difference:.1g}"


def _print_code(code: str) -> None:
    for line in code.splitlines():
        print_message(f"    {line}")


def _export_to_hub(run: Path, folder: Path, licence: str | None) -> int:
    from model.hub_export import export_to_hub
    from model.runs.run_files import run_argument
    from model.runs.run_folder import run_name

    written = export_to_hub(run, folder, licence=licence)
    code = warn(f"{folder}: without an ONNX file: {written.onnx_problem}") if written.onnx_problem else DONE
    if not written.has_driven:
        print_message(
            f"{folder}: its card lists no drives: give `bc-eval drive {run_argument(run)} --tracks lake mountain`,"
            " and export it again"
        )
    if licence is None:
        print_message(f"{folder}: its card states no licence; give one with --license")
    print_result(f"{folder}: {', '.join(written.files)}")
    name = shlex.quote(run_name(run))
    print_next(f"hf upload {name} {shlex.quote(str(folder))}", "to publish it; nothing is uploaded yet")
    return code
