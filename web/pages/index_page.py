"""The index: bins, each session's frames, the split along time, leaks, trials of other settings, and samples as
training sees them."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

import cv2
import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from common import UserError
from common.errors import counted, printable
from common.steering_unit import assumed_deg, steering_unit
from common.untrusted import real_path, whole_number
from dataset import Samples
from dataset.alterations import EpochAlterations
from dataset.config import IndexConfig
from dataset.index.leaks import find_leaks
from dataset.index.sessions import logs_not_indexed
from dataset.loader.crops import Crops
from dataset.parquet_file import read_metadata
from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image
from dataset.samples.samples_format import COUNT_HEADINGS, SAMPLES_NAME
from dataset.samples.samples_reader import LOADED
from model.config import TrainConfig
from web.errors import WebError, or_404
from web.folders.file_versions import version_of
from web.folders.project_folders import key_of
from web.index.index_view import (
    IndexView,
    bins_sketch,
    held_out_rows,
    session_bins_sketch,
    split_sketch,
    view_index,
)
from web.jobs.job_forms import INDEX_FIELDS, form_of, suggested_sessions
from web.logs.session_cards import IndexState
from web.pages.request_values import Values, number_in, on_form
from web.pages.workbench import Workbench
from web.runs.run_configs import differing, index_checksum, origin_of
from web.server.templates import page

SHOWN: Final = 12
_COLUMNS: Final = (*LOADED, "row", "camera", "recorded")


class AlteredSample(msgspec.Struct, frozen=True):
    """`pictures` are the crop as recorded and as trained on, as JPEGs; empty if a picture does not decode."""

    session: str
    row: int
    camera: str
    done: str  # "mirrored, blur, shadow"
    recorded: str  # with its unit: "3.2°"
    label: str
    pictures: tuple[bytes, bytes]


class AlteredSamples(msgspec.Struct, frozen=True):
    """Some training samples of an index, evenly spread."""

    total: int
    shown: list[AlteredSample]


def _read(index: Path, others: int) -> AlteredSamples:
    """`SHOWN` training samples of an index; another number `others` gives others. Raises UserError if the index or
    its logs cannot be read."""
    with Samples(index) as samples:
        table = samples.of_split("train", _COLUMNS)
        # by the golden ratio, the numbers of each round lie between those of earlier rounds
        places = (np.arange(SHOWN) / SHOWN + others * 0.6180339887 / SHOWN) % 1
        chosen = np.unique((places * len(table)).astype(np.int64)) if len(table) else np.arange(0)
        return AlteredSamples(len(table), _shown(samples, table.take(pa.array(chosen)), chosen))


def _shown(samples: Samples, chosen: pa.Table, numbers: NDArray[np.int64]) -> list[AlteredSample]:
    """The `chosen` samples, which have these numbers in an epoch."""
    rows = samples.rows(chosen)
    plain = dataclasses.replace(
        rows, flip=np.zeros(len(rows), np.bool_), alterations=tuple("" for _ in rows.alterations)
    )
    recipe = TrainConfig()
    epoch = EpochAlterations(recipe.epoch_alterations, recipe.seed, samples.settings.side_correction)
    labels = epoch.labels(rows.label, 1, numbers)
    as_recorded = _jpegs(Crops(plain, samples.logs, 0), len(rows))
    as_learnt = _jpegs(
        Crops(rows, samples.logs, 0), len(rows), lambda pictures, at: epoch.alter(1, pictures, numbers[at])
    )
    unit = steering_unit(samples.max_steering_deg)
    full = unit.of(assumed_deg(samples.max_steering_deg))
    return [
        AlteredSample(
            printable(sample["session"]),
            sample["row"],
            printable(sample["camera"]),
            ", ".join(["mirrored"] * sample["flip"] + [name for name in sample["alteration"].split("+") if name]),
            # of the unmirrored picture next to it
            f"{sample['recorded'] * (-1 if sample['flip'] else 1) * full:.1f}{unit.sign}",
            f"{label * full:.1f}{unit.sign}",
            (before, after),
        )
        for sample, label, before, after in zip(
            chosen.to_pylist(), labels.tolist(), as_recorded, as_learnt, strict=True
        )
    ]


def _jpegs(
    crops: Crops, count: int, altered: Callable[[Image, NDArray[np.int64]], object] | None = None
) -> list[bytes]:
    pictures: Image = np.empty((count, *ORIGINAL.shape), np.uint8)
    failed = crops.fill(pictures, np.arange(count), altered)
    return [_jpeg(picture) if number not in failed else b"" for number, picture in enumerate(pictures)]


def _jpeg(picture: Any) -> bytes:
    # each pixel keeps its own colour: mixed colours would run into each other
    sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    ok, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95, *sampling])
    return encoded.tobytes() if ok else b""


def index_routes(bench: Workbench) -> list[Route]:
    def folder_of(request: Request) -> Path:
        """The index, or the requested trial."""
        trial = request.query_params.get("trial", "")
        return bench.trials.get(trial) if trial else bench.folders.index

    def whole(request: Request) -> Response:
        values = dict(request.query_params)
        trial = values.pop("trial", "")
        live = bench.sessions_version()
        index = bench.folders.index
        now, problem = _view(index)
        then, trial_problem = _view(bench.trials.get(trial)) if trial else (None, "")
        stale, is_usual = not_taken_in(bench)
        return page(
            "index.html",
            live=live,
            query=urlencode(request.query_params),
            version_of_index=version_of(index / SAMPLES_NAME),
            trial=trial,
            values=values,
            fields=INDEX_FIELDS,
            project_sessions=suggested_sessions(bench.folders),
            now=now,
            then=then,
            is_missing=not (index / SAMPLES_NAME).exists(),
            is_damaged=bool(problem) and (index / SAMPLES_NAME).exists(),
            problem=problem,
            trial_problem=trial_problem,
            stale=stale,
            is_usual=is_usual,
            headings=COUNT_HEADINGS,
            settings=differing([now.settings, then.settings]) if now and then else [],
            sessions=_sessions(now, then),
            runs=_runs() if now else [],
        )

    def _runs() -> list[tuple[str, str]]:
        """The runs that were trained on the present index, and their pages."""
        now = index_checksum(bench.folders.index)
        runs = bench.folders.run_folders().items()
        return [(printable(path.name), f"/runs/{key}") for key, path in runs if origin_of(path).index == now]

    def bins(request: Request) -> Response:
        return _svg(bins_sketch(view_index(folder_of(request))))

    def session_of(request: Request) -> tuple[Path, str]:
        """The index, and the name of a session that it lists."""
        folder, key = folder_of(request), request.path_params["session"]
        names = (name for name in view_index(folder).counts if "/" not in name and "\\" not in name)
        session = next((name for name in names if key_of(Path(name)) == key), None)
        return folder, or_404(session, f"{folder}: no session {key!r} in it")

    def session_bins(request: Request) -> Response:
        return _svg(session_bins_sketch(*session_of(request)))

    def split(request: Request) -> Response:
        return _svg(split_sketch(*session_of(request)))

    def held_out(request: Request) -> Response:
        """The stretches of held-out rows of a session, as [first, last]."""
        return JSONResponse(held_out_rows(*session_of(request)))

    def samples_of(request: Request) -> AlteredSamples:
        index, others = folder_of(request), _others(request)
        key = f"altered 5 {real_path(index)} {version_of(index / SAMPLES_NAME)} {others}"
        return bench.cache.struct(key, AlteredSamples, lambda: _read(index, others))

    def altered(request: Request) -> Response:
        trial, others = request.query_params.get("trial", ""), _others(request)
        samples = samples_of(request)
        shown = [(number, sample, key_of(Path(sample.session))) for number, sample in enumerate(samples.shown)]
        return page("altered_rows.html", total=samples.total, shown=shown, trial=trial, others=others)

    def altered_picture(request: Request) -> Response:
        """The picture as recorded (0), or as training sees it (1)."""
        number, is_altered = number_in(request, "number"), number_in(request, "is_altered")
        samples = samples_of(request).shown
        if number >= len(samples) or is_altered > 1 or not samples[number].pictures[is_altered]:
            raise WebError(f"sample {number} has no such picture", 404)
        return Response(samples[number].pictures[is_altered], media_type="image/jpeg")

    def leaks(request: Request) -> Response:
        lines = find_leaks(folder_of(request))
        head = counted(len(lines), "leak") if lines else "no leak between training and validation"
        return PlainTextResponse("\n".join(map(printable, [head, *lines])))

    def try_settings(request: Request, values: Values) -> Response:
        form = form_of("index")
        form.words(values, bench.folders)  # raises an error before a folder is made
        key, folder = bench.trials.new(bench.folders.index)
        words = form.words(values, dataclasses.replace(bench.folders, index=folder))
        kept = {name: value for name, value in values.items() if value and name != "form"}
        job = bench.jobs.start(words, f"/index?{urlencode({'trial': key, **kept})}")
        return RedirectResponse(f"/jobs/{job.key}", status_code=303)

    return [
        Route("/index", whole),
        Route("/index.altered", altered),
        Route("/index.altered/{number}/{is_altered}.jpg", altered_picture),
        Route("/index.bins", bins),
        Route("/index.leaks", leaks),
        Route("/index.try", on_form(try_settings), methods=["POST"]),
        Route("/index/{session}/bins", session_bins),
        Route("/index/{session}/split", split),
        Route("/index/{session}/held-out", held_out),
    ]


def not_taken_in(bench: Workbench) -> tuple[list[str], bool]:
    """The sessions that are newer than the index, or have changed since; and whether the index has the settings of
    `bc-index` without flags, so that this takes them in and changes nothing else."""
    cards = bench.cards.cards("sessions")
    names = {card.name for card in cards if card.index.state is IndexState.CHANGED}
    with contextlib.suppress(UserError):
        logs = [log for log in bench.folders.logs("sessions").values() if log.suffix == ".mcap"]
        names |= set(map(printable, logs_not_indexed(bench.folders.index, logs)))
    is_usual = not any(card.index.state is IndexState.PASSED_OVER for card in cards)
    metadata = read_metadata(bench.folders.index / SAMPLES_NAME)
    usual = json.loads(json.dumps(dataclasses.asdict(IndexConfig())))
    return sorted(names), is_usual and metadata is not None and metadata.get("settings") == usual


def taken_in_first(bench: Workbench, form: str, values: Mapping[str, str]) -> list[str]:
    """The command that brings the index up to date before a training on it; none if nothing is missing, or if it
    would change the index's settings. A missing index is built by the training itself."""
    if form != "train" or values.get("on"):
        return []
    names, is_usual = not_taken_in(bench)
    return form_of("index").words({}, bench.folders) if names and is_usual else []


def _others(request: Request) -> int:
    """The number of the choice of samples."""
    return whole_number(request.query_params.get("others", "")) or 0


def _view(folder: Path) -> tuple[IndexView | None, str]:
    try:
        return view_index(folder), ""
    except UserError as error:
        return None, printable(str(error))


def _sessions(now: IndexView | None, then: IndexView | None) -> list[dict[str, Any]]:
    """A row for each session in either index: its counts now, and then."""
    names = sorted({session for view in (now, then) if view for session in view.counts})
    return [
        {
            "name": printable(name),
            "key": key_of(Path(name)),
            "now": now.counts.get(name) if now else None,
            "then": then.counts.get(name) if then else None,
        }
        for name in names
    ]


def _svg(data: bytes) -> Response:
    return Response(data, media_type="image/svg+xml")
