"""The objects that pages share: the project's folders, and data in memory and in the cache."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from dataset.index.build_state import STATE_NAME
from web.folders.cache_folder import CacheFolder
from web.folders.file_versions import version_of
from web.folders.project_folders import ProjectFolders
from web.index.index_view import IndexTrials
from web.jobs.exports import Exports
from web.jobs.jobs import Jobs
from web.logs.drive_view import DriveViews
from web.logs.open_logs import OpenLogs
from web.logs.session_cards import SessionCards
from web.logs.session_stretches import PictureChecks, WhereSearch
from web.processes.picture_maps import PictureMaps
from web.processes.predictions import Predictions
from web.processes.rerun_viewers import RerunViewers
from web.runs.run_cards import RunCards


class Workbench:
    """The shared objects of a server. They can be built anew from the folders."""

    def __init__(self, folders: ProjectFolders, cache: Path) -> None:
        pool = ThreadPoolExecutor(1, "reading logs")
        self._pool = pool
        self.folders = folders
        self.cache = CacheFolder(cache)
        pool.submit(self.cache.tidy)
        self.logs = OpenLogs()
        self.cards = SessionCards(folders, self.cache, pool)
        self.cards.cards("sessions", 0)  # starts to read them before the first request
        self.drives = DriveViews(self.cache, pool)
        self.search = WhereSearch(folders, pool)
        self.checks = PictureChecks(folders.index, cache)
        self.runs = RunCards(folders)
        self.jobs = Jobs(cache)
        self.exports = Exports(cache)
        self.trials = IndexTrials(cache)
        self.viewers = RerunViewers(self.cache)
        self.predictions = Predictions(cache)
        self.maps = PictureMaps(cache)

    def sessions_version(self) -> str:
        """A text that changes with the logs, their tags and the index, and when another log has been read."""
        built = version_of(self.folders.index / STATE_NAME)
        return f"{self.folders.version_of_folder('sessions')} {built} {self.cards.done + self.search.done}"

    def runs_version(self) -> str:
        """A text that changes with every line that a training writes, and when another run has been read."""
        return f"{self.runs.version()} {self.runs.done}"

    def drives_version(self) -> str:
        return f"{self.folders.version_of_folder('drives')} {self.cards.done + self.drives.done}"

    def close(self) -> None:
        self.viewers.close()
        self.predictions.work.close()
        self.maps.work.close()
        self.checks.work.close()
        self._pool.shutdown(cancel_futures=True)
        self.runs.close()
        self.logs.close()


def change_routes(bench: Workbench) -> list[Route]:
    def changes(request: Request) -> Response:
        """The versions of the lists. A page requests its list again when the version has changed."""
        bench.logs.drop_changed()
        return JSONResponse(
            {
                "sessions": bench.sessions_version(),
                "runs": bench.runs_version(),
                "drives": bench.drives_version(),
                "jobs": bench.jobs.version(),
            }
        )

    return [Route("/changes", changes)]
