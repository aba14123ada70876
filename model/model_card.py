"""The card of a run on the Hugging Face hub, its README.md: description, training data, errors, drives, and code
to load it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from common.errors import counted, printable
from common.markdown import as_markdown
from common.steering_unit import assumed_deg
from common.versions import TOOLKIT, version_of
from dataset.prediction_targets import TARGETS, TargetName
from model.runs.kept_results import KeptResult
from model.runs.training_progress import Epoch

NO_LICENCE: Final = "Not stated: ask whoever trained it before you use it."
_TAGS: Final = ("behavioural-cloning", "imitation-learning", "self-driving")


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


class _Counts(msgspec.Struct):
    training: int = 0
    validation: int = 0


class _Plan(msgspec.Struct):
    why: str = ""


class _Labels(msgspec.Struct):
    plan: _Plan = msgspec.field(default_factory=_Plan)


class _Data(msgspec.Struct):
    """The data of a run's config.json, as far as a card lists them."""

    logs: dict[str, Any] = {}
    counts: dict[str, _Counts] = {}
    labels: dict[str, _Labels] = {}


def card(of: ModelCard) -> str:
    """The text of a card: the hub's YAML, then Markdown."""
    return "\n".join(
        [
            *_front_matter(of),
            "",
            f"# {as_markdown(of.name)}",
            "",
            f"A network that steers a car by what its camera sees: {_network(of)},"
            f" {of.parameters:,} parameters. {_answers(of)}",
            "",
            *_learnt_from(of),
            *_measures(of),
            *_drives(of),
            *_loading(of),
            "## What it is not for",
            "",
            "Real cars and real roads. It knows of no other car and no person, and nothing limits what it answers"
            " to pictures of another camera, car or world than those that it learnt from.",
            "",
            "## Licence",
            "",
            as_markdown(of.licence) if of.licence else NO_LICENCE,
            "",
            f"Exported by {TOOLKIT} {version_of()} (`bc-train export --hub`).",
            "",
        ]
    )


def _front_matter(of: ModelCard) -> Iterator[str]:
    yield "---"
    if of.licence:
        yield f"license: {json.dumps(of.licence)}"
    yield "pipeline_tag: robotics"
    yield f"library_name: {TOOLKIT}"
    yield "tags:"
    yield from (f"- {tag}" for tag in (*_TAGS, *(["onnx"] if of.onnx_example else [])))
    if of.epoch is not None and of.epoch.measures.frames:
        yield "metrics:"
        yield "- rmse"
        yield "- mae"
        yield "model-index:"
        yield f"- name: {json.dumps(of.name)}"
        yield "  results:"
        yield "  - task:"
        yield "      type: robotics"
        yield "      name: steering"
        yield "    dataset:"
        yield "      type: driving-logs"
        yield f"      name: {json.dumps('held out of ' + printable(', '.join(_data(of).logs) or 'its logs'))}"
        yield "    metrics:"
        for kind, name, value in _metrics(of.epoch):
            yield f"    - type: {kind}"
            yield f"      name: {name}"
            yield f"      value: {value:.4f}"
    yield "---"


def _metrics(epoch: Epoch) -> list[tuple[str, str, float]]:
    measures = epoch.measures
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


def _data(of: ModelCard) -> _Data:
    try:
        return msgspec.convert(of.config.get("data", {}), _Data)
    except msgspec.ValidationError:
        return _Data()


def _learnt_from(of: ModelCard) -> Iterator[str]:
    data = _data(of)
    yield "## What it learnt from"
    yield ""
    if not data.logs:
        yield "It does not say."
    else:
        yield "| session | pictures learnt from | held out | labels | fingerprint of its log |"
        yield "|---|---|---|---|---|"
        for name, log in data.logs.items():
            counts = data.counts.get(name, _Counts())
            fingerprint = str(log.get("fingerprint", "")) if isinstance(log, dict) else ""
            why = data.labels.get(name, _Labels()).plan.why
            yield (
                f"| {as_markdown(name)} | {counts.training:,} | {counts.validation:,} |"
                f" {as_markdown(why) or '-'} | `{as_markdown(fingerprint[:16])}` |"
            )
        yield ""
        yield "The whole of its settings, also those of its data, is in `config.json`."
    yield ""


def _measures(of: ModelCard) -> Iterator[str]:
    yield "## How well"
    yield ""
    if of.epoch is None or not of.epoch.measures.frames:
        yield "Nobody has measured it: nothing was held out."
        yield ""
        return
    measures = of.epoch.measures
    unit = "degrees of the wheels" if measures.max_deg is not None else measures.unit.name
    yield (
        f"Errors on {counted(measures.frames, 'frame')} held out, whole stretches of time, in {unit},"
        " beside those of predictors that know nothing:"
    )
    yield ""
    yield "| | MAE | RMSE | balanced RMSE: every bin of steering alike | MAE where it turns | correlation |"
    yield "|---|---|---|---|---|---|"
    rows = [
        ("this network", measures.network, measures.balanced_rmse_deg),
        ("always the mean", measures.mean, measures.mean_balanced_rmse_deg),
        ("always straight on", measures.zero, math.nan),
    ]
    for name, errors, balanced in rows:
        angles = (errors.mae_deg, errors.rmse_deg, balanced, errors.turning_mae_deg)
        numbers = (*map(measures.unit.of, angles), errors.correlation)
        yield f"| {name} | {' | '.join(map(_number, numbers))} |"
    if not measures.network.rmse_deg < measures.mean.rmse_deg:
        yield ""
        yield "**No better than always predicting the mean.**"
    for target in of.epoch.targets:
        if target.frames:
            yield ""
            yield f"Of the {as_markdown(str(target))}."
    for picture in of.pictures:
        yield ""
        yield f"![{picture.removesuffix('.png')}]({picture})"
    yield ""


def _drives(of: ModelCard) -> Iterator[str]:
    drives = [kept for kept in of.results if kept.way != "frames"]
    yield "## Where it drives, and where not"
    yield ""
    if not drives:
        yield "**Nobody has let it drive**: small errors on recorded pictures do not say that it keeps to a road."
        yield ""
        return
    for heading, is_clean in (("Without an intervention", True), ("Not without an intervention", False)):
        names = [_place(of, kept) for kept in drives if (kept.result.get("interventions") == 0) is is_clean]
        if names:
            yield f"- {heading}: {'; '.join(names)}."
    yield ""
    yield "| where | km | interventions | autonomy | beside the line, on average | at most | measured |"
    yield "|---|---|---|---|---|---|---|"
    for kept in drives:
        found, is_simulator = kept.result, kept.way == "simulator"
        unit = ("", " of half the road") if is_simulator else ("_m", " m")
        beside = [f"{_number(found.get(f'{name}_offset{unit[0]}'))}{unit[1]}" for name in ("mean", "max")]
        yield (
            f"| {_place(of, kept)} | {_number(_km(found.get('distance_m')))} |"
            f" {_number(found.get('interventions'), 0)} | {_number(found.get('autonomy_percent'), 1)} % |"
            f" {beside[0]} | {beside[1]} | {as_markdown(kept.measured_at[:10])} |"
        )
    yield ""
    yield (
        "Driven by the network in a closed loop: on tracks of the built-in simulator, or on recordings, whose"
        " pictures are warped to where its steering has brought the car. Other roads, speeds and cars: not tried."
    )
    yield ""


def _place(of: ModelCard, kept: KeptResult) -> str:
    found = kept.result
    if kept.way == "recording":
        session = str(found.get("session", "?"))
        learnt = ", which it has learnt from" if session in _data(of).logs else ""
        return f"the recording {as_markdown(session)}{learnt}"
    laps = f"{_number(found.get('laps'))} laps at {_number(found.get('set_speed_mph'), 0)} mph"
    supervised = ", supervised by a person" if kept.way == "supervised" else ""
    return f"{as_markdown(str(found.get('track', '?')))} ({laps}{supervised})"


def _loading(of: ModelCard) -> Iterator[str]:
    yield "## How to load it"
    yield ""
    yield f"`hf download OWNER/NAME --local-dir NAME`, and in that folder, with {TOOLKIT} installed:"
    yield ""
    yield "```python"
    yield "from pathlib import Path"
    yield "from dataset import decode"
    yield "from model import load_pilot"
    if of.code:
        yield "from model.network.own_code import load_code"
    yield ""
    if of.code:
        yield f"load_code({json.dumps(of.code)})  # this runs somebody's code: read it first"
    yield 'pilot = load_pilot(Path("."))'
    yield 'picture = decode(Path("picture.jpg").read_bytes())  # of its camera, uncropped'
    yield "print(pilot.predict(pilot.crop(picture)))"
    yield "```"
    yield ""
    flag = f" --network {of.code}" if of.code else ""
    yield f"`bc-drive .{flag} --simulator lake` lets it drive."
    yield ""
    if of.onnx_example:
        yield "Without it, and without PyTorch (`pip install onnxruntime opencv-python-headless`):"
        yield ""
        yield "```python"
        yield of.onnx_example.rstrip("\n")
        yield "```"
    else:
        yield "There is no ONNX file: the network has something in it that cannot be written as ONNX."
    yield ""


def _km(distance_m: object) -> float:
    return distance_m / 1000 if isinstance(distance_m, int | float) else math.nan


def _number(value: object, digits: int = 2) -> str:
    """A number of a file that is not trusted; "-" where it is none."""
    is_number = isinstance(value, int | float) and math.isfinite(value) and abs(value) < 1e9
    return f"{value:.{digits}f}" if is_number else "-"
