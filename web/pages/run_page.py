"""The page of a run: its data, its errors, its worst frames, and its drives."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from common import UserError
from common.car import MAX_STEERING_DEG
from common.errors import printable
from common.progress import duration_text
from common.steering_unit import DEGREES, SteeringUnit, assumed_deg, steering_unit
from common.stored_settings import settings_from
from common.untrusted import whole_number
from model.config import TrainConfig
from model.runs.network_of_run import is_own_network
from model.runs.run_files import load_config
from web.errors import WebError, or_404
from web.folders.project_folders import PLACES, key_of
from web.jobs.job_forms import in_one_field
from web.pages.request_values import number_in
from web.pages.workbench import Workbench
from web.runs.run_cards import RunCard, badge_of
from web.runs.run_charts import bin_bars
from web.runs.run_configs import index_checksum, origin_of, settings_of
from web.server.templates import page

if TYPE_CHECKING:
    from model.runs.training_progress import Step

_MAX_NUMBERS: Final = 14  # of a result
_MAX_REASONS: Final = 3
_FULL_LOCK_RAD: Final = (
    math.pi / 3
)  # of the drawn line: more than the wheels' angle, to make a few degrees visible
_MACHINES: Final = {"device", "precision", "micro_batch", "threads", "picture_memory_mb"}
_OF_INIT: Final = {"epochs", "network", "targets", "light", "picture_px", "crop_rows", "channels"}
"""Settings that a run takes from its first run, and the epochs, which the form has."""
_LINE: Final = 90.0  # length of the line, in a picture of 128 by 128


def run_routes(bench: Workbench) -> list[Route]:
    def worst_picture(request: Request) -> Response:
        """The picture of a worst frame after an epoch, as the network saw it."""
        epoch, number = number_in(request, "epoch"), number_in(request, "number")
        path = bench.folders.run(request.path_params["run"])
        worst = next((worst for worst in bench.runs.history(path).worst if worst.epoch == epoch), None)
        if worst is None or number >= len(worst.jpegs):
            raise WebError(f"{path}: no such frame after epoch {epoch}", 404)
        return Response(worst.jpegs[number], media_type="image/jpeg")

    def _run(key: str) -> Path:
        """Raises WebError if there is no such run, or not yet."""
        if key not in bench.folders.run_folders():
            for job in bench.jobs.trainings(f"/runs/{key}"):
                if job.is_running:
                    raise WebError(f"{job.title}: has not begun yet; reload this page in a moment", 404)
                if not job.is_good:
                    raise WebError(
                        f"{job.title}: {job.state}, and left no network; Activity shows its output", 404
                    )
        return bench.folders.run(key)

    def whole(request: Request) -> Response:
        # without the versions of logs, which may still be read: the first poll refreshes it
        live, key = bench.runs_version(), request.path_params["run"]
        path = _run(key)
        cards = {card.key: card for card in bench.runs.cards()}
        card = or_404(cards.get(key), f"{path}: the run was deleted or renamed")
        # a session goes before a drive with the same key
        pages = {key: f"/{place}/{key}" for place in reversed(PLACES) for key in bench.folders.logs(place)}
        config = None
        with contextlib.suppress(UserError):  # damaged, or changed meanwhile
            config = load_config(path)
        again = _again(bench, card, config)
        return page(
            "run.html",
            live=live,
            card=card,
            path=printable(str(path)),
            summary=card.summary,
            job=bench.jobs.training(f"/runs/{key}"),
            progress=progress_of(bench, card),
            badge=badge_of(card.summary),
            again=again,
            not_as_before=_not_as_before(bench, card, config) if again and config else "",
            settings=settings_of(config) if config is not None else {},
            sessions=_sessions(pages, card),
            is_of_index=_is_of_index(path, bench.folders.index),
            results=_results(pages, card),
            drives=[
                (drive.name, f"/drives/{drive.key}")
                for drive in bench.cards.cards("drives")
                if drive.info and drive.info.session.get("run") == path.name
            ],
            scatter_logs=_scatter_logs(bench, pages, card),
            **_worst(bench, pages, path, card, request.query_params.get("epoch", "")),
        )

    return [
        Route("/runs/{run}", whole),
        Route("/runs/{run}/worst/{epoch}/{number}.jpg", worst_picture),
    ]


class Progress(NamedTuple):
    """How far a training is: the learnt share, and the time left in words, "" if it is not known yet."""

    share: float
    left: str


def progress_of(bench: Workbench, card: RunCard) -> Progress | None:
    """None if the run is not being trained."""
    if not card.is_training:
        return None
    asked = card.summary.epochs_asked if card.summary else 0
    steps: Sequence[Step] = ()
    with contextlib.suppress(UserError):  # damaged, or changed meanwhile
        steps = bench.runs.history(card.path).steps
    if not steps or not asked:
        return Progress(0.0, "")
    last = steps[-1]
    done, total = (last.epoch - 1) * last.batches + last.batch, asked * last.batches
    left_s = last.samples / done * (total - done) / last.samples_per_s if last.samples_per_s > 0 else math.nan
    left = f"about {duration_text(left_s)}" if math.isfinite(left_s) else ""
    return Progress(done / total, left)


def _again(bench: Workbench, card: RunCard, config: dict[str, Any] | None) -> str:
    """The query of a form that trains with the settings of this run again; "" if no form can."""
    run = card.summary
    if run is None or config is None or is_own_network(config):
        return ""
    try:
        settings = settings_from(TrainConfig, config.get("training"))
    except ValueError:  # damaged
        return ""
    init = str(config["init"].get("run") or "") if isinstance(config.get("init"), dict) else ""
    changed = _changed(settings, TrainConfig.of(settings.recipe))
    match config.get("data"):
        case {"settings": {"drives": "takeovers"}}:
            logs = _takeovers(bench, run.sessions, init)
            if not logs or changed.keys() - _OF_INIT:
                return ""
            values = {"run": init, "takeovers": logs, "epochs": settings.epochs, "recipe": settings.recipe}
            return urlencode({"start": "learn", **values})
    values = {"network": run.network, "epochs": str(run.epochs_asked)}
    values |= {"recipe": run.recipe, "targets": " ".join(run.targets), "seed": str(run.seed)}
    for name, value in changed.items():
        values[name] = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
    if _is_on(config, card):
        values["on"] = in_one_field(run.sessions)
        if not values["on"]:
            return ""
    values["init"] = init
    return urlencode({"start": "train", **{name: value for name, value in values.items() if value}})


def _not_as_before(bench: Workbench, card: RunCard, config: Mapping[str, Any]) -> str:
    """Why a training with the settings of this run would learn from other data; "" if it would not."""
    data = config.get("data")
    before = data.get("logs") if isinstance(data, dict) else None
    now: dict[str, str] = {}
    for place in reversed(PLACES):
        now |= bench.cards.fingerprints(place)
    reasons = []
    for session, log in before.items() if isinstance(before, dict) else ():
        if session not in now:
            reasons.append(f"{printable(session)} is not in these folders")
        elif now[session] and isinstance(log, dict) and log.get("fingerprint", now[session]) != now[session]:
            reasons.append(f"{printable(session)} has changed")
    if not reasons and not _is_on(config, card):
        index = index_checksum(bench.folders.index)
        return "the index is another one" if index not in ("", origin_of(card.path).index) else ""
    return ", ".join(reasons[:_MAX_REASONS]) + ", and others" * (len(reasons) > _MAX_REASONS)


def _is_on(config: Mapping[str, Any], card: RunCard) -> bool:
    """Whether a run has an index of its own, as `--on` and `--takeovers` build it."""
    return str(config.get("index")).endswith(f"index-{card.path.name}")


def _changed(settings: TrainConfig, usual: TrainConfig) -> dict[str, Any]:
    """The settings that differ from the usual ones, without those of the machine."""
    before = asdict(usual)
    return {
        name: value for name, value in asdict(settings).items() if value != before[name] and name not in _MACHINES
    }


def _takeovers(bench: Workbench, sessions: Sequence[str], init: str) -> str:
    """The drives among the sessions of a run from which its first run `init` has not learnt, as the value of a
    field; "" if one is not in the folder of drives."""
    earlier = next((card.summary for card in bench.runs.cards() if card.name == init), None)
    if earlier is None:
        return ""
    drives = {log.name.removesuffix(".mcap"): str(log.absolute()) for log in bench.folders.logs("drives").values()}
    added = [drives.get(name, "") for name in sessions if name not in earlier.sessions]
    return in_one_field(added) if all(added) else ""


def _is_of_index(run: Path, index: Path) -> bool:
    now = index_checksum(index)
    return bool(now) and origin_of(run).index == now


def _sessions(pages: Mapping[str, str], card: RunCard) -> list[tuple[str, str]]:
    """The sessions that a run learnt from, and their pages; "" for a session that is in none of the folders."""
    return [(printable(name), _page_of(pages, name)) for name in (card.summary.sessions if card.summary else ())]


def _scatter_logs(bench: Workbench, pages: Mapping[str, str], card: RunCard) -> list[tuple[str, str, str]]:
    """The logs that a run may predict, those that it learnt from first: name, address, and the address of the
    held-out rows, "" if they are unknown."""
    is_of_index = _is_of_index(card.path, bench.folders.index)
    learnt = {address: name for name, address in _sessions(pages, card) if address}
    logs = [(name, at, f"/index/{at.split('/')[-1]}/held-out" * is_of_index) for at, name in learnt.items()]
    for place in PLACES:
        for key, name in bench.folders.finished(place).items():
            if (at := f"/{place}/{key}") not in learnt:
                logs.append((name, at, ""))
    return logs


def _end_of_line(steering_deg: float, max_deg: float | None) -> str:
    """The end of a steering line in a picture of 128 by 128. The line begins in the middle of the lower edge."""
    share = max(-1.0, min(1.0, steering_deg / assumed_deg(max_deg)))
    turn = share * _FULL_LOCK_RAD
    return f"{64 + _LINE * math.sin(turn):.1f},{128 - _LINE * math.cos(turn):.1f}"


def _page_of(pages: Mapping[str, str], session: str) -> str:
    """The page of a session's log; "" if it is in none of the folders."""
    return pages.get(key_of(Path(f"{session.replace('/', ' ')}.mcap")), "")


def _results(pages: Mapping[str, str], card: RunCard) -> list[dict[str, Any]]:
    results = []
    for kept in card.summary.results if card.summary else ():
        log = kept.result.get("log")
        results.append(
            {
                "way": kept.way,
                "when": printable(kept.measured_at),
                "numbers": _numbers(kept.result),
                "log": _page_of(pages, Path(log).name.removesuffix(".mcap")) if isinstance(log, str) else "",
            }
        )
    return results


def _numbers(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The names and values of the plain numbers and texts in a result."""
    from model.runs.run_summary import measured_sessions

    numbers = []
    if sessions := measured_sessions(result):
        numbers.append(("of", printable(", ".join(sessions))))
    if isinstance(network := result.get("network"), dict):  # errors on frames; those of steering are in degrees
        numbers += _numbers_of(network, steering_unit(result.get("max_deg", MAX_STEERING_DEG)))
    return [*numbers, *_numbers_of(result)][:_MAX_NUMBERS]


def _numbers_of(result: Mapping[str, Any], unit: SteeringUnit = DEGREES) -> list[tuple[str, str]]:
    numbers = []
    for name, value in result.items():
        if unit != DEGREES and name.endswith("_deg") and isinstance(value, float):
            name, value = f"{name.removesuffix('_deg')}, {unit.name}", unit.of(value)
        if name == "log" or isinstance(value, bool) or value is None or isinstance(value, dict | list):
            continue
        if isinstance(value, str) and len(value) > 40:  # checksums, paths
            continue
        text = f"{value:.4g}" if isinstance(value, float) and math.isfinite(value) else str(value)
        numbers.append((printable(name.replace("_", " ")), printable(text)))
    return numbers


def _worst(
    bench: Workbench, pages: Mapping[str, str], path: Path, card: RunCard, requested: str
) -> dict[str, Any]:
    """The worst frames after the requested epoch; by default, the kept or the newest one."""
    try:
        history = bench.runs.history(path)
    except UserError as error:
        return {"worst": [], "epochs": [], "epoch": 0, "kept": 0, "bins": None, "problem": printable(str(error))}
    kept = card.summary.kept_epoch if card.summary else 0
    by_epoch = {worst.epoch: worst for worst in history.worst}
    usual = max(by_epoch, default=0) if card.is_training else kept
    epoch = usual if (number := whole_number(requested)) is None else number
    if epoch not in by_epoch and by_epoch:
        epoch = max(by_epoch)
    worst = by_epoch.get(epoch)
    max_deg = worst.max_deg if worst else None
    frames = []
    for number, frame in enumerate(worst.frames) if worst else ():
        address = _page_of(pages, frame.session)
        frames.append(
            {
                "picture": f"/runs/{card.key}/worst/{epoch}/{number}.jpg",
                "session": printable(frame.session),
                "frame": frame,
                "predicted": _end_of_line(frame.predicted_deg, max_deg),
                "recorded": _end_of_line(frame.recorded_deg, max_deg),
                "address": f"{address}#row={frame.row}&run={card.key}" if address else "",
            }
        )
    measures = next((measured.measures for measured in history.epochs if measured.epoch == epoch), None)
    return {
        "worst": frames,
        "bins": bin_bars(measures) if measures else None,
        "worst_unit": steering_unit(max_deg) if worst else DEGREES,
        "epochs": list(by_epoch),
        "epoch": epoch,
        "kept": kept,
        "problem": "",
    }
