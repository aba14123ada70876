"""The workbench as an ASGI app: its pages, its static files, what guards them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.routing import Mount
from starlette.types import ASGIApp

from common.location import Url
from web.folders.cache_folder import CacheFolder
from web.folders.project_folders import PLACES, ProjectFolders
from web.index.index_trials import IndexTrials
from web.jobs.jobs import Jobs
from web.logs.drive_view import DriveViews
from web.logs.open_logs import OpenLogs
from web.logs.picture_checks import PictureChecks
from web.logs.session_cards import SessionCards
from web.logs.where_search import WhereSearches
from web.pages.altered_page import altered_routes
from web.pages.attention_page import attention_routes
from web.pages.bulk_page import bulk_routes
from web.pages.changes import change_routes
from web.pages.compare_page import compare_routes
from web.pages.course_page import course_routes
from web.pages.drives_page import drive_routes
from web.pages.import_page import import_routes
from web.pages.index_page import index_routes
from web.pages.jobs_page import job_routes
from web.pages.log_files import log_file_routes
from web.pages.log_jobs_page import log_job_routes
from web.pages.log_links import log_link_routes
from web.pages.map_page import map_routes
from web.pages.predictions_page import prediction_routes
from web.pages.rerun_page import rerun_log_routes, rerun_routes
from web.pages.run_page import run_routes
from web.pages.runs_page import run_list_routes
from web.pages.session_page import session_routes
from web.pages.sessions_page import session_list_routes
from web.pages.wheel_pages import wheel_routes
from web.pages.wheel_socket import wheel_socket_routes
from web.pages.workbench import Workbench
from web.processes.picture_maps import PictureMaps
from web.processes.predictions import Predictions
from web.processes.rerun_viewers import RerunViewers
from web.runs.attention import Attention
from web.runs.run_cards import RunCards
from web.server.error_pages import HANDLERS
from web.server.memory import TrimmedApp
from web.server.request_guard import RequestGuard
from web.server.static_files import STATIC, PageFiles

_FROM_STORES: Final = 8  # logs
_AS_THEY_ARE: Final = (  # compressed already, or sent bit by bit
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    "application/grpc-web",
    "application/grpc-web+proto",
    "application/wasm",
    "application/x-ndjson",
)
_OF_A_LOG: Final = (
    session_routes,
    course_routes,
    log_file_routes,
    log_link_routes,
    rerun_log_routes,
    prediction_routes,
    attention_routes,
    log_job_routes,
)


@contextlib.contextmanager
def workbench_app(folders: ProjectFolders, host: str, token: str, cache: Path) -> Iterator[ASGIApp]:
    """The app, until the context is left. Raises UserError where a folder is in a store, and what reads stores is
    not installed."""
    with contextlib.ExitStack() as stack:
        if folders.are_in_stores:
            from common.store_connection import hurried  # an extra

            stack.enter_context(hurried())
        yield stack.enter_context(_app(folders, host, token, cache))


@contextlib.contextmanager
def _app(folders: ProjectFolders, host: str, token: str, cache: Path) -> Iterator[ASGIApp]:
    pool = ThreadPoolExecutor(1, "reading logs")
    # of a store, several at a time: an answer takes long, however little is asked for
    from_stores = ThreadPoolExecutor(_FROM_STORES, "reading from stores")
    pools = {place: from_stores if isinstance(getattr(folders, place), Url) else pool for place in PLACES}
    logs = OpenLogs(folders)
    kept = CacheFolder(cache)
    pool.submit(kept.tidy)
    cards = SessionCards(folders, kept, pools)
    cards.cards("sessions", 0)  # begins to read them before the first request
    checks = PictureChecks(folders.index_here, kept)
    runs = RunCards(folders)
    viewers = RerunViewers(kept)
    predictions = Predictions(cache)
    maps = PictureMaps(cache)
    bench = Workbench(
        folders,
        kept,
        logs,
        cards,
        DriveViews(folders, kept, pools["drives"]),
        WhereSearches(folders, pools["sessions"]),
        checks,
        runs,
        Jobs(cache),
        IndexTrials(cache),
        viewers,
        predictions,
        Attention(),
        maps,
    )
    routes = [
        *session_list_routes(bench),
        *bulk_routes(bench),
        *change_routes(bench),
        *(route for place in PLACES for routes in _OF_A_LOG for route in routes(bench, place)),
        *rerun_routes(bench),
        *drive_routes(bench),
        *index_routes(bench),
        *altered_routes(bench),
        *map_routes(bench),
        *job_routes(bench),
        *import_routes(bench),
        *wheel_routes(bench),
        *wheel_socket_routes(),
        *compare_routes(bench),
        *run_list_routes(bench),
        *run_routes(bench),
        Mount(STATIC, PageFiles()),
    ]
    try:
        app = Starlette(routes=routes, exception_handlers=HANDLERS)
        small = GZipMiddleware(app, compresslevel=5, exclude_content_types=_AS_THEY_ARE)
        yield TrimmedApp(RequestGuard(small, host, token))
    finally:
        viewers.close()
        predictions.work.close()
        maps.work.close()
        pool.shutdown(cancel_futures=True)
        from_stores.shutdown(cancel_futures=True)
        runs.close()
        checks.close()
        logs.close()
