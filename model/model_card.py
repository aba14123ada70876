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
    """The contents of a card."""

    name: str
    config: Mapping[str, Any]  # of the run; checked as far as driving needs it
    parameters: int
    targets: Sequence[TargetName]
    max_steering_deg: float | None  # None: unknown
    epoch: Epoch | None  # of these weights; None: how well it learnt is unknown
    results: Sequence[KeptResult]  # the last of each kind that these weights have given
    licence: str | None
    code: str  # the name to load it by; empty for a network of the toolkit
    onnx_example: str  # Python; empty if there is no ONNX file
    pictures: Sequence[str]  # of how it was learnt, by file name


def card(of: ModelCard) -> str:
    """The text of a card: the hub's YAML, then Markdown."""
    data, measures = (
        index_of_config(of.config),
        of.epoch.measures if of.epoch and of.epoch.measures.frames else None,
    )
    drives = [kept for kept in of.results if kept.way != "frames"]
    places = [
        (heading, [_place(of, kept) for kept in drives if (kept.result.get("interventions") == 0) is is_clean])
        for heading, is_clean in (("Without an intervention", True), ("Not without an intervention", False))
    ]
    return rendered(
        "model",
        "model_card.md.jinja",
        card=of,
        toolkit=TOOLKIT,
        version=version_of(),
        network=_network(of),
        answers=_answers(of),
        data=data,
        held_out=f"held out of {printable(', '.join(data.logs) or 'its logs')}",
        sessions=[_session(name, log, data) for name, log in data.logs.items()],
        measures=measures,
        metrics=_metrics(measures) if measures else [],
        errors=_errors(measures) if measures else [],
        unit=_unit(measures) if measures else "",
        drives=[_drive(of, kept) for kept in drives],
        places=places,
    )


def _metrics(measures: Measures) -> list[tuple[str, str, float]]:
    found = [
        ("rmse", "RMSE of the steering", measures.network.rmse_deg),
        ("rmse", "balanced RMSE of the steering", measures.balanced_rmse_deg),
        ("mae", "MAE of the steering", measures.network.mae_deg),
    ]
    unit = measures.unit
    return [(kind, f"{name} in {unit.name}", unit.of(deg)) for kind, name, deg in found if math.isfinite(deg)]


def _network(of: ModelCard) -> str:
    stored = of.config.get("network")
    name = stored.get("name") if isinstance(stored, dict) else None
    return f"`{printable(name)}`" if isinstance(name, str) and "`" not in name else "`original`"


def _answers(of: ModelCard) -> str:
    degrees = f"{assumed_deg(of.max_steering_deg):g} degrees of the wheels"
    if of.max_steering_deg is None:
        degrees = "full lock, an unknown angle"
    others = [f"{name} ({TARGETS[name].unit or '-1 to 1'})" for name in of.targets[1:]]
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
    """The rows of the table of errors."""
    rows = [
        ("this network", measures.network, measures.balanced_rmse_deg),
        ("always the mean", measures.mean, measures.mean_balanced_rmse_deg),
        ("always straight on", measures.zero, math.nan),
    ]
    found = []
    for name, errors, balanced in rows:
        angles = (errors.mae_deg, errors.rmse_deg, balanced, errors.turning_mae_deg)
        found.append((name, [*map(measures.unit.of, angles), errors.correlation]))
    return found


def _drive(of: ModelCard, kept: KeptResult) -> dict[str, object]:
    """A row of the table of drives."""
    ending, unit = ("", " of half the road") if kept.way == "simulator" else ("_m", " m")
    distance_m = kept.result.get("distance_m")
    return {
        "place": _place(of, kept),
        "km": distance_m / 1000 if isinstance(distance_m, int | float) else math.nan,
        "interventions": kept.result.get("interventions"),
        "autonomy": kept.result.get("autonomy_percent"),
        "mean": kept.result.get(f"mean_offset{ending}"),
        "max": kept.result.get(f"max_offset{ending}"),
        "unit": unit,
        "day": kept.measured_at[:10],
    }


def _place(of: ModelCard, kept: KeptResult) -> str:
    found = kept.result
    if kept.way == "recording":
        session = str(found.get("session", "?"))
        learnt = ", which it has learnt from" if session in index_of_config(of.config).logs else ""
        return f"the recording {as_markdown(session)}{learnt}"
    laps = f"{shown_number(found.get('laps'))} laps at {shown_number(found.get('set_speed_mph'), 0)} mph"
    supervised = ", supervised by a person" if kept.way == "supervised" else ""
    return f"{as_markdown(str(found.get('track', '?')))} ({laps}{supervised})"
