"""The versions of the lists. A page requests its list again when the version has changed."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from dataset.index.build_state import STATE_NAME
from web.folders.file_versions import version_of
from web.pages.workbench import Workbench


def change_routes(bench: Workbench) -> list[Route]:
    def changes(request: Request) -> Response:
        bench.logs.drop_changed()
        return JSONResponse(
            {
                "sessions": sessions_version(bench),
                "runs": runs_version(bench),
                "drives": drives_version(bench),
                "jobs": bench.jobs.version(),
            }
        )

    return [Route("/changes", changes)]


def sessions_version(bench: Workbench) -> str:
    """A text that changes with the logs, their tags and the index, and when another log has been read."""
    folders = bench.folders
    folders.refresh_index()
    built = version_of(folders.local_index / STATE_NAME)
    return f"{folders.version_of_folder('sessions')} {built} {bench.cards.done + bench.searches.done}"


def runs_version(bench: Workbench) -> str:
    """A text that changes with every line that a training writes, and when another run has been read."""
    return f"{bench.runs.version()} {bench.runs.done}"


def drives_version(bench: Workbench) -> str:
    return f"{bench.folders.version_of_folder('drives')} {bench.cards.done + bench.drives.done}"
