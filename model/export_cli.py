"""`bc-train export`: a run as a file that other programs can use."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.command import DONE, run_command
from common.output import print_result


@dataclass(frozen=True)
class Export:
    """Write a run's network as an ONNX file, checked in ONNX Runtime; how to use it stands in its metadata."""

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """The run, by name or folder."""
    onnx: Annotated[tuple[()] | tuple[Path], tyro.conf.arg(metavar="[FILE]")]
    """Where to write the ONNX file; without a name, into the run's folder: NAME.onnx."""
    network: str | None = None
    """Code that a run's network is of, for a run of your own network: FILE.py:CLASS or package.module:CLASS."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    force: bool = False
    """Replace a file of the same name."""


def export(config: Export) -> int:
    from model.onnx_export import export_onnx
    from model.runs.network_of_run import load_named
    from model.runs.run_folder import find_run, load_config, run_name

    run = find_run(config.run, config.runs)
    if config.network is not None:
        load_named([config.network], [load_config(run)])
    path = config.onnx[0] if config.onnx else run / f"{run_name(run)}.onnx"
    difference = export_onnx(run, path, overwrite=config.force)
    print_result(f"{path}: written; steering in ONNX Runtime and in PyTorch: largest difference {difference:.1g}")
    return DONE


def main() -> None:
    """Run `bc-train export`: `sys.argv` begins with the first argument, `export`."""
    del sys.argv[1]
    run_command("bc-train export", Export, export)
