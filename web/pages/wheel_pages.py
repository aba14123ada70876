"""At the wheel: the form that begins a drive, the page of the drive, its socket, and the page after it.

The socket forwards messages between the page and the process that drives.
"""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.frames import CloseCode

from common.errors import printable
from common.files import session_name
from model.runs.run_files import is_being_trained
from recorder.log.tags import EXCLUDE, Tag
from recorder.teleop.wheel import open_wheels
from recorder.topics import PERSON_METADATA
from web.errors import WebError, or_404
from web.folders.project_folders import PLACES, Place, ProjectFolders, key_of
from web.jobs.job_forms import refuse_taken
from web.jobs.wheels import (
    DEFAULTS,
    RATES_HZ,
    TRACKS,
    EndedDrive,
    beginning_of,
    ended_drive,
    free_name,
    is_training_on,
    new_drive,
    place_of,
    running,
    takeovers,
    training,
)
from web.logs.drive_view import BEFORE_S, DriveView, drive_map, rows_before_put_back
from web.pages.request_values import Values, on_form
from web.pages.tagging import TagChange, change_tags
from web.pages.workbench import Workbench
from web.runs.run_configs import origin_of
from web.server.templates import page

_MAX_FRAME_BYTES: Final = 8 << 20
_PATIENCE_S: Final = 5.0
_QUEUE: Final = 2  # messages for a slow page; then the process waits


def wheel_routes(bench: Workbench) -> list[BaseRoute]:
    def whole(request: Request) -> Response:
        driver = request.query_params.get("driver", DEFAULTS["driver"])
        name = free_name(beginning_of(driver), bench.folders)
        values = {**DEFAULTS, "name": name, **request.query_params}
        runs = [(key, _named(run)) for key, run in bench.folders.run_folders().items()]
        wheels = open_wheels(Path.cwd())
        problem = ""
        try:
            refuse_taken(values["name"], "drives" if values["driver"] == "run" else "sessions", bench.folders)
        except WebError as error:
            problem = str(error)
        context = {"values": values, "problem": problem, "tracks": TRACKS, "rates": RATES_HZ}
        return page("wheels.html", runs=runs, wheels=wheels, **context)

    def rows(request: Request) -> Response:
        return page("wheel_rows.html", wheels=open_wheels(Path.cwd()))

    def start(request: Request, values: Values) -> Response:
        drive = new_drive(values, bench.folders)
        if drive.key in bench.folders.logs(drive.place):  # back to the form, with its values and the problem
            return RedirectResponse(f"/wheel?{urlencode(values)}", status_code=303)
        job = bench.jobs.start(drive.words, _after(drive.place, drive.key), records=True)
        return RedirectResponse(f"/wheel/begin/{job.key}", status_code=303)

    def begin(request: Request) -> Response:
        """A page that waits until the drive of a job can be steered."""
        job = bench.jobs.get(request.path_params["job"])
        address = _address(job.about.made, bench.folders) if job.is_running else ""
        if not address and job.is_good and not job.is_running and "hx-request" not in request.headers:
            return RedirectResponse(job.about.made, status_code=303)  # Back, after the drive
        if not address:
            return page("wheel_begin.html", job=job)
        if "hx-request" in request.headers:
            return Response(headers={"HX-Redirect": address})
        return RedirectResponse(address, status_code=303)

    def drive(request: Request) -> Response:
        key = request.path_params["key"]
        wheel = next((wheel for wheel in open_wheels(Path.cwd()) if wheel.key == key), None)
        kept = f"drive of {key}"
        if wheel is None and (ended := bench.cache.find(kept)):  # a reload, or Back
            return RedirectResponse(ended.decode(), status_code=303)
        wheel = wheel or running(key)
        place = place_of(wheel, bench.folders)
        after = _after(*place) if place else ""
        bench.cache.keep(kept, after.encode())
        return page("wheel.html", title=printable(wheel.title), at=f"/wheel/{wheel.key}", after=after)

    def train(request: Request, values: Values) -> Response:
        """Train a network on a session, without the seconds before the car was put back if the form says so, or on
        the takeovers of a drive."""
        place, key, ended = _ended_drive(request)
        log = or_404(ended, "nothing was recorded, so there is nothing to train on").log
        if "leave_out" in values:
            opened = bench.logs.open(log)
            fingerprint, rows = opened.log.fingerprint, rows_before_put_back(opened)
            if rows:
                change_tags(bench, place, log, TagChange("add", EXCLUDE, rows, fingerprint))
        words, run = training(place, log, bench.folders)
        bench.jobs.start(words, f"/runs/{key_of(Path(run))}")
        return RedirectResponse(_after(place, key), status_code=303)

    def after(request: Request) -> Response:
        """The page of an ended drive's log, with the next steps."""
        place, key, ended = _ended_drive(request)
        context: dict[str, Any] = {"at": _after(place, key), "name": key, "log": ""}
        if ended is None:
            return page("wheel_after.html", **context)
        context |= {
            "name": printable(session_name(ended.log)),
            "log": f"/{place}/{key_of(ended.log)}",
            "is_growing": ended.is_growing,
            "is_whole": ended.is_whole,
        }
        if ended.is_growing:
            return page("wheel_after.html", **context)
        opened = bench.logs.open(ended.log)
        metadata = opened.log.metadata
        states = opened.states
        length_s = float(states.time_ns[-1] - states.time_ns[0]) / 1e9 if len(states.row) else 0.0
        taken = takeovers(opened.log)
        is_ours = place == "drives" or metadata.get("track") or opened.log.read_metadata(PERSON_METADATA)
        rows = len(states.row)
        left_road = [] if place == "drives" else rows_before_put_back(opened)
        tags = set(bench.cards.tags(ended.log, opened.log.fingerprint).tags) if left_road else set()
        view = bench.drives.views([ended.log], _PATIENCE_S).get(ended.log)
        by = "who drove" if place == "drives" else "drive"
        runs = bench.folders.run_folders()
        drove = key_of(Path(metadata["run"])) if metadata.get("run") else ""
        name = session_name(ended.log)
        job = next((job for job in bench.jobs.all() if is_training_on(job, ended.log)), None)
        learnt = [(key, _named(run)) for key, run in runs.items() if name in origin_of(run).sessions]
        return page(
            "wheel_after.html",
            **context,
            rows=rows,
            map=drive_map([view], [0], by) if isinstance(view, DriveView) else None,
            left_road=[stretch for stretch in left_road if Tag(*stretch, EXCLUDE) not in tags],
            before_s=BEFORE_S,
            length_s=length_s,
            taken=taken,
            drove=drove if drove in runs else "",
            is_ours=is_ours,  # not imported, so one can drive on from its end
            is_supervised=place == "drives",
            job=job,
            has_curves=job is not None and job.about.made.rpartition("/")[2] in runs,
            learnt=[] if job and job.is_running else learnt,
            like=f"{place}/{key}",
        )

    def _ended_drive(request: Request) -> tuple[Place, str, EndedDrive | None]:
        """The folder and the key of a drive's log, and the log, if there is one."""
        name, key = request.path_params["place"], request.path_params["log"]
        place: Place = or_404(next((place for place in PLACES if place == name), None), "no such folder of logs")
        return place, key, ended_drive(place, key, bench.folders)

    async def forward(socket: WebSocket) -> None:
        try:
            process = await _process(socket.path_params["key"])
        except WebError:
            await socket.close()
            return
        async with process:
            with contextlib.suppress(WebSocketDisconnect):
                await socket.accept()
                await _carry(socket, process)
            await process.close()
            code = process.close_code
            is_reason = code in (CloseCode.POLICY_VIOLATION, CloseCode.MESSAGE_TOO_BIG)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # the page has closed it
                await socket.close(code if is_reason and code else CloseCode.NORMAL_CLOSURE)

    at = "/wheel/after/{place}/{log}"
    return [
        Route("/wheel", whole),
        Route("/wheel", on_form(start), methods=["POST"]),
        Route("/wheel.rows", rows),
        Route("/wheel/begin/{job}", begin),
        Route(at, after),
        Route(f"{at}/train", on_form(train), methods=["POST"]),
        Route("/wheel/{key}", drive),
        WebSocketRoute("/wheel/{key}/socket", forward),
    ]


def _named(run: Path) -> str:
    """A network in the name of a button or a choice."""
    return printable(run.name) + " (still learning)" * is_being_trained(run)


def _after(place: Place, key: str) -> str:
    return f"/wheel/after/{place}/{key}"


def _address(made: str, folders: ProjectFolders) -> str:
    """The address of the running drive whose log the page `made` will show; "" before it can be steered."""
    for wheel in open_wheels(Path.cwd()):
        if (place := place_of(wheel, folders)) and _after(*place) == made:
            return f"/wheel/{wheel.key}"
    return ""


async def _process(key: str) -> ClientConnection:
    """A connection to the process that drives. Raises WebError if it has ended, or takes no more pages."""
    wheel = await run_in_threadpool(running, key)
    try:
        return await connect(
            f"ws://127.0.0.1:{wheel.port}",
            additional_headers={"Authorization": f"Bearer {wheel.token}"},
            compression=None,
            max_size=_MAX_FRAME_BYTES,
            max_queue=_QUEUE,
            proxy=None,
            open_timeout=_PATIENCE_S,
            close_timeout=1,
        )
    except (OSError, WebSocketException):
        raise WebError("the drive has ended, or takes no more pages", 503) from None


async def _carry(page: WebSocket, process: ClientConnection) -> None:
    """Forward messages until either side closes. Each side waits for the other, so that nothing piles up."""
    ways = [asyncio.create_task(_to_process(page, process)), asyncio.create_task(_to_page(page, process))]
    try:
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for way in ways:
            way.cancel()
        for result in await asyncio.gather(*ways, return_exceptions=True):
            if isinstance(result, Exception) and not isinstance(result, (ConnectionClosed, WebSocketDisconnect)):
                raise result


async def _to_process(page: WebSocket, process: ClientConnection) -> None:
    while (message := await page.receive())["type"] == "websocket.receive":
        text = message.get("text")
        await process.send(message["bytes"] if text is None else text)


async def _to_page(page: WebSocket, process: ClientConnection) -> None:
    async for data in process:
        if isinstance(data, str):
            await page.send_text(data)
        else:
            await page.send_bytes(data)
