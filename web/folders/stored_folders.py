"""Folders in stores, as far as pages need them: their listings, and copies of the small ones."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

from common.errors import StoreError
from common.location import Url
from common.users_cache import cached_copy
from web.folders.refreshed import Refreshed

if TYPE_CHECKING:
    from common.object_store import StoredObject

Listing = Mapping[Url, "StoredObject"]


class StoreListings:
    """The latest listings of folders in stores."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listed: dict[Url, Refreshed[Listing]] = {}
        self._changed_here: dict[
            Url, tuple[float, StoredObject | None]
        ] = {}  # objects asked for since a listing began, and when

    def refresh(self, folder: Url) -> None:
        """List the folder anew, if the last time is some seconds ago; only pages that show it need to."""
        self._of(folder).refresh()

    def objects(self, folder: Url) -> Listing:
        """The objects directly in a folder, as it was listed last."""
        listed = self._of(folder)
        if listed.value is None:
            listed.refresh()
        with self._lock:
            changed = {url: found for url, (_, found) in self._changed_here.items() if url.parent == folder}
        objects = listed.value or {}
        if not changed:
            return objects
        return {url: found for url, found in {**objects, **changed}.items() if found is not None}

    def refresh_object(self, url: Url) -> None:
        """Ask for an object that was changed from here: the next listing may be seconds away."""
        from common.object_store import find_object  # an extra

        now_s = time.monotonic()
        with contextlib.suppress(StoreError):
            found = find_object(url)
            with self._lock:
                self._changed_here[url] = now_s, found

    def problem(self, folder: Url) -> str:
        """The reason why there is no newer listing; empty if there is one."""
        return self._of(folder).problem

    def find(self, url: Url) -> StoredObject | None:
        return self.objects(url.parent).get(url)

    def _of(self, folder: Url) -> Refreshed[Listing]:
        with self._lock:
            if folder not in self._listed:
                self._listed[folder] = Refreshed(str(folder), lambda before: self._list(folder))
            return self._listed[folder]

    def _list(self, folder: Url) -> Listing:
        began_s = time.monotonic()
        found = _list(folder)
        with self._lock:
            known = [
                url for url, (at_s, _) in self._changed_here.items() if url.parent == folder and at_s < began_s
            ]
            for url in known:
                del self._changed_here[url]
        return found


class StoredCopy:
    """A copy of a folder of small files, for pages that read it; it is brought again when its listing has changed.

    It is not the one in which `bc-index` works: that shall not find it in use.
    """

    def __init__(self, url: Url) -> None:
        self.here = cached_copy(url, "shown")
        self._url = url
        self._listed = Refreshed[Listing](str(url), self._brought)

    def refresh(self) -> None:
        """Fetch what has changed, if the last refresh is some seconds ago."""
        self._listed.refresh()

    @property
    def problem(self) -> str:
        """The reason why the copy is outdated; empty if it is not."""
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
