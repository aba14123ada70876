"""The state that pages share: the folders they show, and what is kept of them in memory and in the cache."""

from __future__ import annotations

from dataclasses import dataclass

from web.data.attention import Attention
from web.data.cache_folder import CacheFolder
from web.data.drive_view import DriveViews
from web.data.index_trials import IndexTrials
from web.data.jobs import Jobs
from web.data.open_logs import OpenLogs
from web.data.picture_checks import PictureChecks
from web.data.picture_maps import PictureMaps
from web.data.predictions import Predictions
from web.data.project_folders import ProjectFolders
from web.data.rerun_viewers import RerunViewers
from web.data.run_cards import RunCards
from web.data.session_cards import SessionCards
from web.data.where_search import WhereSearches


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
