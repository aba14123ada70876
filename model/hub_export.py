"""Export a run as a folder for the Hugging Face hub: weights, settings, an ONNX file, and a card.

The folder is a run, too: `bc-drive FOLDER` and `load_pilot` accept it. It does not contain the paths of the run's
index, logs and code on this machine.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.errors import printable
from common.files import new_folder
from common.markdown import as_markdown, rendered, shown_number
from common.steering_unit import assumed_deg
from common.versions import TOOLKIT, version_of
from dataset.prediction_targets import TARGETS, TargetName
from model.errors import RunError, RunWriteError
from model.metrics import Measures
from model.network.names import is_own
from model.network.own_code import named_code
from model.onnx_export import example, export_onnx, require_onnx
from model.runs.car_of_run import known_max_steering_deg_of_run
from model.runs.history import read_epochs
from model.runs.network_of_run import NETWORK_FILE, stored_network
from model.runs.run_files import KeptResult, run_write_errors
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
from model.runs.run_numbers import StoredCounts, StoredIndex, StoredLabels, index_of_config
from model.runs.run_summary import last_results
from model.runs.training_progress import Epoch


@dataclass(frozen=True)
class ModelCard:
    name: str
    config: Mapping[str, Any]  # of the run; only the settings for driving are checked
    parameters: int
    targets: Sequence[TargetName]
    max_steering_deg: float | None  # None: unknown
    epoch: Epoch | None  # of these weights; None: unknown
    results: Sequence[KeptResult]  # of these weights, the last of each kind
    licence: str | None
    code: str  # the name that loads the network's code; empty for a network of the toolkit
    onnx_example: str  # Python; empty if there is no ONNX file


def card(about: ModelCard) -> str:
    """The text of a card: the hub's YAML, then Markdown."""
    data = index_of_config(about.config)
    measures = about.epoch.measures if about.epoch and about.epoch.measures.frames else None
    drives = [kept for kept in about.results if kept.way != "frames"]
    places = [
        (heading, [_place(about, kept) for kept in drives if (kept.result.get("interventions") == 0) is is_clean])
        for heading, is_clean in (("Without an intervention", True), ("Not without an intervention", False))
    ]
    return rendered(
        "model",
        "model_card.md.jinja",
        card=about,
        toolkit=TOOLKIT,
        version=version_of(),
        network=_network(about),
        answers=_answers(about),
        data=data,
        held_out=f"held out of {printable(', '.join(data.logs) or 'its logs')}",
        sessions=[_session(name, log, data) for name, log in data.logs.items()],
        measures=measures,
        metrics=_metrics(measures) if measures else [],
        errors=_errors(measures) if measures else [],
        unit=_unit(measures) if measures else "",
        drives=[_drive(about, kept) for kept in drives],
        places=places,
    )


def _metrics(measures: Measures) -> list[tuple[str, str, float]]:
    metrics = [
        ("rmse", "RMSE of the steering", measures.network.rmse_deg),
        ("rmse", "balanced RMSE of the steering", measures.balanced_rmse_deg),
        ("mae", "MAE of the steering", measures.network.mae_deg),
    ]
    unit = measures.unit
    return [(kind, f"{name} in {unit.name}", unit.of(deg)) for kind, name, deg in metrics if math.isfinite(deg)]


def _network(about: ModelCard) -> str:
    stored = about.config.get("network")
    name = stored.get("name") if isinstance(stored, dict) else None
    return f"`{printable(name)}`" if isinstance(name, str) and "`" not in name else "`original`"


def _answers(about: ModelCard) -> str:
    degrees = f"{assumed_deg(about.max_steering_deg):g} degrees of the wheels"
    if about.max_steering_deg is None:
        degrees = "full lock, an unknown angle"
    others = [f"{name} ({TARGETS[name].unit or '-1 to 1'})" for name in about.targets[1:]]
    answers = ", and the ".join([f"steering, -1 (left) to 1 (right), where 1 is {degrees}", *others])
    return f"It answers the {answers}; nothing is clamped."


def _session(name: str, log: object, data: StoredIndex) -> dict[str, object]:
    counts = data.counts.get(name, StoredCounts())
    return {
        "name": name,
        "training": counts.training,
        "validation": counts.validation,
        "why": data.labels.get(name, StoredLabels()).plan.why,
        "fingerprint": str(log.get("fingerprint", ""))[:16] if isinstance(log, dict) else "",
    }


def _unit(measures: Measures) -> str:
    return "degrees of the wheels" if measures.max_deg is not None else measures.unit.name


def _errors(measures: Measures) -> list[tuple[str, list[float]]]:
    rows = [
        ("this network", measures.network, measures.balanced_rmse_deg),
        ("always the mean", measures.mean, measures.mean_balanced_rmse_deg),
        ("always straight on", measures.zero, math.nan),
    ]
    table = []
    for name, errors, balanced in rows:
        angles = (errors.mae_deg, errors.rmse_deg, balanced, errors.turning_mae_deg)
        table.append((name, [*map(measures.unit.of, angles), errors.correlation]))
    return table


def _drive(about: ModelCard, kept: KeptResult) -> dict[str, object]:
    ending, unit = ("", " of half the road") if kept.way == "simulator" else ("_m", " m")
    distance_m = kept.result.get("distance_m")
    return {
        "place": _place(about, kept),
        "km": distance_m / 1000 if isinstance(distance_m, int | float) else math.nan,
        "interventions": kept.result.get("interventions"),
        "autonomy": kept.result.get("autonomy_percent"),
        "mean": kept.result.get(f"mean_offset{ending}"),
        "max": kept.result.get(f"max_offset{ending}"),
        "unit": unit,
        "day": kept.measured_at[:10],
    }


def _place(about: ModelCard, kept: KeptResult) -> str:
    result = kept.result
    if kept.way == "recording":
        session = str(result.get("session", "?"))
        learnt = ", part of its training data" if session in index_of_config(about.config).logs else ""
        return f"the recording {as_markdown(session)}{learnt}"
    laps = f"{shown_number(result.get('laps'))} laps at {shown_number(result.get('set_speed_mph'), 0)} mph"
    supervised = ", supervised by a person" if kept.way == "supervised" else ""
    return f"{as_markdown(str(result.get('track', '?')))} ({laps}{supervised})"


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
