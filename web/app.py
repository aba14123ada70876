"""The workbench as an ASGI app: pages, static files, and access control."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.routing import BaseRoute, Mount
from starlette.types import ASGIApp

from web.folders.project_folders import PLACES, ProjectFolders
from web.pages.common_pages import common_routes
from web.pages.compare_page import compare_routes
from web.pages.drives_page import drive_routes
from web.pages.home_page import home_routes
from web.pages.import_page import import_routes
from web.pages.index_page import index_routes
from web.pages.jobs_page import job_routes
from web.pages.log_files import log_file_routes
from web.pages.map_page import map_routes
from web.pages.rerun_page import rerun_log_routes, rerun_routes
from web.pages.run_page import run_routes
from web.pages.runs_page import run_list_routes
from web.pages.session_page import session_routes
from web.pages.sessions_page import session_list_routes
from web.pages.wheel_pages import wheel_routes
from web.pages.workbench import Workbench, change_routes
from web.server.request_guard import HANDLERS, RequestGuard
from web.server.templates import STATIC, PageFiles

_NOT_COMPRESSED: Final = (  # already compressed, or sent in small parts
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    "application/wasm",
    "application/x-ndjson",
)


@contextlib.contextmanager
def workbench_app(
    folders: ProjectFolders, host: str, token: str, cache: Path, *, once: str = ""
) -> Iterator[ASGIApp]:
    """The app, until the context is left; `token` and `once` as in `RequestGuard`."""
    with contextlib.closing(Workbench(folders, cache)) as bench:
        app = Starlette(routes=routes_of(bench), exception_handlers=HANDLERS)
        compressed = GZipMiddleware(app, compresslevel=5, exclude_content_types=_NOT_COMPRESSED)
        yield RequestGuard(compressed, host, token, once)


def routes_of(bench: Workbench) -> list[BaseRoute]:
    per_log = session_routes, log_file_routes, rerun_log_routes
    return [
        *home_routes(bench),
        *session_list_routes(bench),
        *change_routes(bench),
        *(route for place in PLACES for routes in per_log for route in routes(bench, place)),
        *rerun_routes(bench),
        *drive_routes(bench),
        *index_routes(bench),
        *map_routes(bench),
        *job_routes(bench),
        *common_routes(bench),
        *import_routes(bench),
        *wheel_routes(bench),
        *compare_routes(bench),
        *run_list_routes(bench),
        *run_routes(bench),
        Mount(STATIC, PageFiles()),
    ]
