"""Folders in stores, as far as pages need them: what is in them, and copies of the small ones."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING

from common.location import Url
from common.users_cache import users_cache
from web.data.refreshed import Refreshed

if TYPE_CHECKING:
    from common.object_store import StoredObject

Listing = Mapping[Url, "StoredObject"]


class StoreListings:
    """What folders in stores hold, as they were listed last."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listed: dict[Url, Refreshed[Listing]] = {}

    def look(self, folder: Url) -> None:
        """List it anew, if the last time is some seconds ago; pages that show a folder do, others need not."""
        self._of(folder).look()

    def objects(self, folder: Url) -> Listing:
        """What is right in a folder, as it was listed last."""
        listed = self._of(folder)
        if listed.value is None:
            listed.look()
        return listed.value or {}

    def problem(self, folder: Url) -> str:
        """Why there is no newer listing; empty if there is."""
        return self._of(folder).problem

    def find(self, url: Url) -> StoredObject | None:
        return self.objects(url.parent).get(url)

    def _of(self, folder: Url) -> Refreshed[Listing]:
        with self._lock:
            if folder not in self._listed:
                self._listed[folder] = Refreshed(str(folder), lambda before: _list(folder))
            return self._listed[folder]


class StoredCopy:
    """A copy of a folder of small files, for pages that read it; it is brought again when its listing has changed.

    It is not the one in which `bc-index` works: that shall not find it in use.
    """

    def __init__(self, url: Url) -> None:
        digest = hashlib.sha256(str(url).encode()).hexdigest()[:12]
        self.here = users_cache() / "shown" / digest / (url.name or url.bucket)
        self._url = url
        self._listed = Refreshed[Listing](str(url), self._brought)

    def look(self) -> None:
        """Bring what has changed, if the last time that anybody looked is some seconds ago."""
        self._listed.look()

    @property
    def problem(self) -> str:
        """Why it is not as it is there; empty if it is."""
        return self._listed.problem

    def _brought(self, before: Listing | None) -> Listing:
        listed = _list(self._url)
        if listed != before:
            from common.stored_folder import StoredFolder  # an extra

            with StoredFolder(self._url, self.here, waits=True) as folder:
                folder.bring()
        return listed


def _list(folder: Url) -> Listing:
    from common.object_store import list_objects  # an extra

    return {each.url: each for each in list_objects(folder)}
