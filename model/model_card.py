"""The card of a run on the Hugging Face hub, its README.md: description, training data, errors, drives, and code
to load it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from common.errors import printable
from common.markdown import as_markdown, rendered, shown_number
from common.steering_unit import assumed_deg
from common.versions import TOOLKIT, version_of
from dataset.prediction_targets import TARGETS, TargetName
from model.metrics import Measures
from model.runs.kept_results import KeptResult
from model.runs.run_numbers import StoredCounts, StoredIndex, StoredLabels, index_of_config
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
