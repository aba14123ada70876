"""The state that pages share: the folders they show, and what is kept of them in memory and in the cache."""

from __future__ import annotations

from dataclasses import dataclass

from web.folders.cache_folder import CacheFolder
from web.folders.project_folders import ProjectFolders
from web.index.index_trials import IndexTrials
from web.jobs.jobs import Jobs
from web.logs.drive_view import DriveViews
from web.logs.open_logs import OpenLogs
from web.logs.picture_checks import PictureChecks
from web.logs.session_cards import SessionCards
from web.logs.where_search import WhereSearches
from web.processes.picture_maps import PictureMaps
from web.processes.predictions import Predictions
from web.processes.rerun_viewers import RerunViewers
from web.runs.attention import Attention
from web.runs.run_cards import RunCards


@dataclass(frozen=True)
class Workbench:
    """The shared objects of a server. All of them can be built anew from the folders."""

    folders: ProjectFolders
    cache: CacheFolder
    logs: OpenLogs
    cards: SessionCards
    drives: DriveViews
    searches: WhereSearches
    checks: PictureChecks
    runs: RunCards
    jobs: Jobs
    trials: IndexTrials
    viewers: RerunViewers
    predictions: Predictions
    attention: Attention
    maps: PictureMaps
