"""The versions of what the lists show: a page asks for its list again when that of its own has changed."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from dataset.index.build_state import STATE_NAME
from web.data.file_versions import version_of, version_of_folder
from web.pages.workbench import Workbench


def change_routes(bench: Workbench) -> list[Route]:
    folders = bench.folders

    def changes(request: Request) -> Response:
        read = bench.cards.done + bench.searches.done
        built = version_of(folders.index / STATE_NAME)
        return JSONResponse({"sessions": f"{version_of_folder(folders.sessions)} {built} {read}"})

    return [Route("/changes", changes)]
