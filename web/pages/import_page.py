"""Import: a recording is dropped or chosen, what it holds is shown, and a job makes a session of it."""

from __future__ import annotations

from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from common.errors import printable
from common.files import publish
from common.interrupts import uninterrupted
from common.location import Url
from common.whole_number import whole_number
from recorder.log.tags import tags_path
from recorder.sources.find_recording import recordings_in
from recorder.sources.import_mcap import is_own_log
from recorder.sources.recording_summary import summarize_recording
from web.data.job_forms import form_of
from web.data.project_folders import key_of
from web.data.uploads import MAX_FILES, MAX_UPLOAD_BYTES, Upload, plain_name, remove_upload, uploads_in
from web.errors import WebError
from web.pages.form_values import form_values
from web.pages.workbench import Workbench
from web.server.request_guard import UPLOAD
from web.server.templates import render

_MAX_SHOWN = 50  # recordings of an upload


def import_routes(bench: Workbench) -> list[Route]:
    folder = bench.folders.recordings

    def page(request: Request) -> Response:
        limits = {"bytes": MAX_UPLOAD_BYTES, "files": MAX_FILES}
        return HTMLResponse(
            render("import.html", limits=limits, uploads=list(uploads_in(folder)), form=form_of("import"))
        )

    async def upload(request: Request) -> Response:
        """Receive an upload; `manifest` in the address: the length of what it begins with."""
        total = whole_number(request.headers["content-length"])
        manifest = whole_number(request.query_params.get("manifest", ""))
        chunks = request.stream()
        try:
            with Upload(folder, manifest or 0, total or 0) as received:
                async for chunk in chunks:
                    await run_in_threadpool(received.write, chunk)
                found = await run_in_threadpool(received.finish)
        except ClientDisconnect:
            return Response(status_code=400)  # to nobody
        except (WebError, OSError):
            async for _ in chunks:  # else the browser shows that the connection broke, and not why
                pass
            raise
        if await request.is_disconnected():  # cancelled while it was unpacked
            await run_in_threadpool(remove_upload, found)
        return JSONResponse({"page": f"/import/{found.name}"})

    def one(request: Request) -> Response:
        path = _upload(request)
        found = recordings_in(path)
        taken = {log.name.removesuffix(".mcap") for log in bench.folders.logs("sessions").values()}
        shown = [(summarize_recording(each), _free_name(each, path, taken)) for each in found[:_MAX_SHOWN]]
        fields = {field.name: field for field in form_of("import").fields}
        more = len(found) - len(shown)
        return HTMLResponse(
            render("import_one.html", name=path.name, folder=path, found=shown, fields=fields, more=more)
        )

    async def take(request: Request) -> Response:
        """Make a log of this toolkit a session: it gets its place there, as it is."""
        values = await form_values(request)
        path = _upload(request)
        log = next((each for each in recordings_in(path) if str(each) == values.get("source")), None)
        if log is None or not is_own_log(log):
            raise WebError(f"{path}: no such log in it; open its page anew", 404)
        page_of = await run_in_threadpool(_take, log, values.get("name", ""))
        if not recordings_in(path):
            await run_in_threadpool(remove_upload, path)
        return RedirectResponse(page_of, status_code=303)

    def _take(log: Path, name: str) -> str:
        sessions = bench.folders.sessions
        if isinstance(sessions, Url):
            raise WebError(f"`bc-log copy {printable(str(log))} {sessions}` copies it there", 422)
        if not name or plain_name(name) != name:
            raise WebError(f"{printable(name)!r}: a plain name was expected, such as {plain_name(name)}", 422)
        to = sessions / f"{name}.mcap"
        sessions.mkdir(parents=True, exist_ok=True)
        with uninterrupted():
            publish(log, to, overwrite=False)
            if tags_path(log).is_file():
                publish(tags_path(log), tags_path(to), overwrite=False)
        return f"/sessions/{key_of(to)}"

    def remove(request: Request) -> Response:
        remove_upload(_upload(request))
        return RedirectResponse("/import", status_code=303)

    def _upload(request: Request) -> Path:
        name = request.path_params["name"]
        path = uploads_in(folder).get(name)
        if path is None:
            raise WebError(f"{folder}: no upload {name!r} in it; it may have been removed", 404)
        return path

    return [
        Route("/import", page),
        Route(UPLOAD, upload, methods=["POST"]),
        Route("/import/{name}", one),
        Route("/import/{name}/take", take, methods=["POST"]),
        Route("/import/{name}/remove", remove, methods=["POST"]),
    ]


def _free_name(recording: Path, upload: Path, taken: set[str]) -> str:
    """A name for its session that no other has."""
    is_only = recording == upload or recording.parent == upload
    name = plain_name(upload.name if is_only else recording.name)
    return next(each for each in (name, *(f"{name}-{number}" for number in range(2, 10_000))) if each not in taken)
