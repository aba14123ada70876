"""The tags of logs. Memory keeps them while their files are unchanged. The cache also keeps tags from stores."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common.location import Location
from recorder.log.tags import Tag, tags_by_content, tags_path
from web.folders.cache_folder import CacheFolder
from web.folders.file_versions import Newest
from web.folders.project_folders import ProjectFolders

_KEPT: Final = 10_000  # logs


@dataclass(frozen=True)
class FileTags:
    """The contents of a log's file of tags."""

    version: str  # of the file
    tags: list[Tag]  # of this content of the log, in the order of their rows
    stale: int  # tags of an earlier log with this name


class LogTags:
    """The tags of all logs."""

    def __init__(self, folders: ProjectFolders, cache: CacheFolder) -> None:
        self._folders = folders
        self._cache = cache
        self._tags = Newest[Location, FileTags](_KEPT)

    def read(self, path: Location, fingerprint: str) -> FileTags:
        """The tags of this content of a log. Raises LogError for a damaged file, StoreError."""
        version = self._folders.version_of(tags_path(path))

        def parse() -> FileTags:
            by_content = self._by_content(path, version)
            tags = sorted(by_content.pop(fingerprint, ()))
            return FileTags(version, tags, sum(map(len, by_content.values())))

        return self._tags.get(path, f"{version} {fingerprint}", parse)

    def _by_content(self, path: Location, version: str) -> dict[str, set[Tag]]:
        if isinstance(path, Path):
            return tags_by_content(path)
        if not self._folders.has_tags(path):
            return {}
        self._folders.refuse_unanswered(path)
        key = f"tags 1 {path} {version}"
        return self._cache.struct(key, dict[str, set[Tag]], lambda: tags_by_content(path))
