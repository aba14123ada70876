"""Import: a user drops or chooses a recording, sees its contents, and a job makes a session of it."""

from __future__ import annotations

import contextlib
import os
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from common.errors import printable
from common.files import publish, session_name
from common.interrupts import uninterrupted
from common.untrusted import real_path, whole_number
from recorder import Log, LogError
from recorder.log.tags import tags_path
from recorder.new_session import plain_name
from recorder.sources.find_recording import folders_in, recordings_in
from recorder.sources.import_recording import RecordingSummary, summarize_recording
from recorder.sources.mcap_recording import is_own_log
from web.errors import WebError, or_404
from web.folders.project_folders import key_of
from web.folders.uploads import MAX_FILES, MAX_UPLOAD_BYTES, Upload, remove_upload, uploads_in
from web.jobs.job_forms import form_of
from web.logs.session_cards import SessionCard
from web.pages.request_values import Values, on_form
from web.pages.workbench import Workbench
from web.server.request_guard import UPLOAD
from web.server.templates import page

_MAX_SHOWN = 50  # recordings in a folder
_MAX_FOLDERS = 500
_SUFFIXES = (".mcap", ".csv")  # of files that may be recordings
_PATIENCE_S = 2.0  # for logs that are being read


@dataclass(frozen=True)
class Offer:
    recording: RecordingSummary
    name: str  # that no session has
    here: SessionCard | None  # that it seems to have become

    @property
    def is_ready(self) -> bool:
        """Whether it needs no answer of the user."""
        return not (self.recording.problem or self.recording.needs or self.here)


def import_routes(bench: Workbench) -> list[Route]:
    folder = bench.folders.recordings

    def whole(request: Request) -> Response:
        limits = {"bytes": MAX_UPLOAD_BYTES, "files": MAX_FILES}
        return page("import.html", limits=limits, uploads=list(uploads_in(folder)))

    async def upload(request: Request) -> Response:
        """Receive an upload. `manifest` in the address is the length of its manifest."""
        total = whole_number(request.headers["content-length"])
        manifest = whole_number(request.query_params.get("manifest", ""))
        chunks = request.stream()
        try:
            with Upload(folder, manifest or 0, total or 0) as received:
                async for chunk in chunks:
                    await run_in_threadpool(received.write, chunk)
                uploaded = await run_in_threadpool(received.finish)
        except (WebError, OSError):
            async for _ in chunks:  # a browser shows the reason only after it has sent everything
                pass
            raise
        if await request.is_disconnected():  # cancelled while it was unpacked
            await run_in_threadpool(remove_upload, uploaded)
        return JSONResponse({"page": f"/import/{uploaded.name}"})

    def uploaded_recordings(request: Request) -> Response:
        path = _upload(request)
        return page("import_recordings.html", title=path.name, **_context(path, recordings_in(path)))

    def browse(request: Request) -> Response:
        """A folder or file of this machine: its recordings and its folders."""
        source = request.query_params.get("source", "").strip()
        try:
            place = real_path(Path(source).expanduser() if source else Path.home())
            is_folder = place.is_dir()
            if not is_folder and not place.is_file():
                raise FileNotFoundError
        except (OSError, RuntimeError, ValueError):
            raise WebError(f"{printable(source)}: no such folder or file on the machine of bc-web", 404) from None
        files = recordings_in(place, levels=0) if is_folder else [place]
        recordings = [file for file in files if file.is_dir() or file.suffix.lower() in _SUFFIXES]
        inner = [folder for folder in folders_in(place) if not folder.name.startswith(".")] if is_folder else []
        recordings, inner = ([path for path in paths if str(path).isprintable()] for paths in (recordings, inner))
        context = {"inner": inner[:_MAX_FOLDERS], "above": place.parent, "title": printable(str(place))}
        return page("import_recordings.html", **context, **_context(place, recordings))

    def _offers(place: Path, recordings: list[Path]) -> list[Offer]:
        cards = bench.cards.cards("sessions", _PATIENCE_S)
        taken = {card.name for card in cards}
        contents = bench.cards.fingerprints("sessions", _PATIENCE_S)
        imported = {card.info.session.get("recording"): card for card in cards if card.info}
        copied = {contents.get(session_name(card.path)): card for card in cards}
        offers = []
        for recording in recordings:
            name = place.name if recording.is_dir() and len(recordings) == 1 else recording.name
            summary, free = summarize_recording(recording), _free_name(plain_name(name), taken)
            taken.add(free)
            here = imported.get(_name_before(recording, folder))
            if summary.is_own:
                with contextlib.suppress(LogError), Log(recording) as log:
                    here = copied.get(log.fingerprint)
            offers.append(Offer(summary, free, here))
        return offers

    def _context(place: Path, recordings: list[Path]) -> dict[str, Any]:
        shown = _offers(place, recordings[:_MAX_SHOWN])
        return {
            "ready": sum(offer.is_ready for offer in shown),
            "name": place.name,
            "folder": place,
            "recordings": shown,
            "fields": {field.name: field for field in form_of("import").fields},
            "not_shown": len(recordings) - len(shown),
        }

    def take(request: Request, values: Values) -> Response:
        """Move a log of this toolkit, unchanged, to the sessions."""
        path = _upload(request)
        log = next((file for file in recordings_in(path) if str(file) == values.get("source")), None)
        if log is None or not is_own_log(log):
            raise WebError(f"{path}: no such log in it; reload its page", 404)
        taken = _take(log, values.get("name", ""))
        if not recordings_in(path):
            remove_upload(path)
        return RedirectResponse(f"/sessions/{key_of(taken)}", status_code=303)

    def take_all(request: Request) -> Response:
        """Import each recording of an upload that asks nothing and is not here yet, one after the other."""
        path, form = _upload(request), form_of("import")
        starts = []
        for offer in _offers(path, recordings_in(path)):
            if offer.is_ready and offer.recording.is_own:
                _take(offer.recording.path, offer.name)
            elif offer.is_ready:
                values = {"source": str(offer.recording.path), "name": offer.name}
                words, page_of = form.words(values, bench.folders), form.page_of(values, bench.folders)
                starts.append(partial(bench.jobs.start, words, page_of, form.name, values))
        if starts:
            bench.jobs.start_in_turn(starts)
        if not recordings_in(path):
            remove_upload(path)
        return RedirectResponse("/jobs" if starts else "/sessions", status_code=303)

    def _take(log: Path, name: str) -> Path:
        sessions = bench.folders.sessions
        if not name or plain_name(name) != name:
            raise WebError(f"{printable(name)!r}: expected a plain name, such as {plain_name(name)}", 422)
        to = sessions / f"{name}.mcap"
        if taken := [path for path in (to, tags_path(to)) if os.path.lexists(path)]:
            raise WebError(f"{taken[0]}: exists already; give another name", 409)
        sessions.mkdir(parents=True, exist_ok=True)
        with uninterrupted():
            publish(log, to, overwrite=False)
            if tags_path(log).is_file():
                publish(tags_path(log), tags_path(to), overwrite=False)
        return to

    def remove(request: Request) -> Response:
        remove_upload(_upload(request))
        return RedirectResponse("/import", status_code=303)

    def _upload(request: Request) -> Path:
        name = request.path_params["name"]
        return or_404(
            uploads_in(folder).get(name), f"{folder}: no upload {name!r} in it; it may have been removed"
        )

    return [
        Route("/import", whole),
        Route("/import.at", browse),
        Route(UPLOAD, upload, methods=["POST"]),
        Route("/import/{name}", uploaded_recordings),
        Route("/import/{name}/take", on_form(take), methods=["POST"]),
        Route("/import/{name}/all", take_all, methods=["POST"]),
        Route("/import/{name}/remove", remove, methods=["POST"]),
    ]


def _name_before(recording: Path, uploads: Path) -> str:
    """The name of a recording before a second upload of it got a number."""
    first = re.sub(r"-\d+$", "", recording.name)
    is_again = recording.parent == uploads and (uploads / first).exists()
    return first if is_again else recording.name


def _free_name(name: str, taken: set[str]) -> str:
    names = (name, *(f"{name}-{number}" for number in range(2, 10_000)))
    return next(free for free in names if free not in taken)
