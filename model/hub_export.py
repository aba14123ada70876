"""Export a run as a folder for the Hugging Face hub: weights, settings, an ONNX file, and a card.

The folder is a run, too: `bc-drive FOLDER` and `load_pilot` accept it. It does not contain the paths of the run's
index, logs and code on this machine.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.files import new_folder
from model.errors import RunError, RunWriteError
from model.model_card import ModelCard, card
from model.network.names import is_own
from model.network.own_code import named_code
from model.onnx_export import example, export_onnx, require_onnx
from model.runs.car_of_run import known_max_steering_deg_of_run
from model.runs.history import read_epochs
from model.runs.network_of_run import NETWORK_FILE, stored_network
from model.runs.run_files import run_write_errors
from model.runs.run_folder import (
    CONFIG,
    WEIGHTS,
    config_folder,
    load_config,
    load_network,
    picture_of_run,
    run_name,
    targets_of_run,
)
from model.runs.run_summary import last_results

ONNX_FILE, CARD_FILE = "model.onnx", "README.md"


@dataclass(frozen=True)
class HubFolder:
    folder: Path
    files: tuple[str, ...]
    has_driven: bool
    """True if the card lists drives."""
    onnx_problem: str
    """The reason for a missing ONNX file; empty if the file exists."""


def export_to_hub(run: Path | str, folder: Path | str, *, licence: str | None = None) -> HubFolder:
    """Write a run as the new folder `folder`, which appears whole or not at all. Uploads nothing.

    If the network cannot be written as ONNX, the ONNX file is missing, and `onnx_problem` is the reason. Raises
    RunError if the run is incomplete, damaged or of another version, if it needs a user's own network that was not
    named (`load_code`), if ONNX is not installed, or if the disk is full. Raises UserError if `folder` exists.
    """
    run, folder = Path(run), Path(folder)
    if config_folder(run) != run:
        raise RunError(f"{run}: a run in training has no final weights; give a finished run: {config_folder(run)}")
    require_onnx()
    config = load_config(run)
    network = load_network(run)
    code, own_file = _own_code(config, run)
    epochs = [epoch for epoch in read_epochs(run) if epoch.is_best]
    results = last_results(run)
    with new_folder(folder) as part, run_write_errors(folder):
        shutil.copyfile(run / WEIGHTS, part / WEIGHTS)
        (part / CONFIG).write_text(json.dumps(without_places(config), indent=2) + "\n", encoding="utf-8")
        if own_file:
            (part / NETWORK_FILE).write_bytes(own_file)
        onnx_problem = _write_onnx(run, part / ONNX_FILE)
        about = ModelCard(
            name=run_name(run),
            config=config,
            parameters=sum(weight.numel() for weight in network.parameters()),
            targets=targets_of_run(run),
            max_steering_deg=known_max_steering_deg_of_run(run),
            epoch=epochs[-1] if epochs else None,
            results=results,
            licence=licence,
            code=code,
            onnx_example="" if onnx_problem else example(picture_of_run(run), f'"{ONNX_FILE}"', '"picture.jpg"'),
        )
        (part / CARD_FILE).write_text(card(about), encoding="utf-8")
        files = tuple(sorted(path.name for path in part.iterdir()))
    return HubFolder(folder, files, any(kept.way != "frames" for kept in results), onnx_problem)


def without_places(config: Mapping[str, Any]) -> dict[str, Any]:
    """A run's config.json without the paths of its index, its logs, its first weights and its code."""
    kept: dict[str, Any] = json.loads(json.dumps(config))
    kept.pop("index", None)
    if isinstance(init := kept.get("init"), dict):
        init.pop("place", None)
    earlier = init.get("data") if isinstance(init, dict) else None
    for data in (kept.get("data"), *(earlier if isinstance(earlier, list) else [])):
        logs = data.get("logs") if isinstance(data, dict) else None
        for log in logs.values() if isinstance(logs, dict) else ():
            if isinstance(log, dict):
                log.pop("log", None)
    training, network = kept.get("training"), kept.get("network")
    if isinstance(training, dict) and isinstance(network, dict) and "network" in training:
        training["network"] = network.get("name")  # without the folder of its file
    return kept


def _own_code(config: dict[str, Any], run: Path) -> tuple[str, bytes]:
    """The name that loads a user's own network from the new folder, and the content of its file, if it has one.
    Both are empty for a network of the toolkit."""
    stored = stored_network(config, run)
    if not is_own(stored.name):
        return "", b""
    code = named_code(stored.name, stored.file_sha256)
    if code is None or not code.source:
        return stored.name, b""
    return f"{NETWORK_FILE}:{stored.name.rpartition(':')[2]}", code.source


def _write_onnx(run: Path, path: Path) -> str:
    """Write the ONNX file. Returns the reason if ONNX cannot represent the network, else an empty string."""
    try:
        export_onnx(run, path)
    except RunWriteError:
        raise
    except RunError as error:  # a layer that ONNX does not support, or answers that differ
        return str(error).removeprefix(f"{run}: ").removeprefix(f"{path}: ")
    return ""
