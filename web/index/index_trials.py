"""Trial indexes: indexes with other settings, in the cache."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from pathlib import Path
from typing import Final

from common.untrusted import real_path
from dataset.frames.image_check_cache import IMAGE_CHECKS_FOLDER
from web.errors import or_404

_KEPT: Final = 4


class IndexTrials:
    """The newest trials. The folder may be deleted at any time."""

    def __init__(self, cache: Path) -> None:
        self._folder = cache / "trials"

    def new(self, index: Path) -> tuple[str, Path]:
        """A name and a folder for a trial. The folder gets the index's checks of pictures, which take long."""
        trials = sorted(self._trials().values(), key=lambda path: path.stat().st_mtime_ns)
        for path in trials[: max(0, len(trials) + 1 - _KEPT)]:
            shutil.rmtree(path, ignore_errors=True)
        folder = self._folder / secrets.token_hex(6)
        folder.mkdir(parents=True)
        with contextlib.suppress(OSError, shutil.Error):
            shutil.copytree(index / IMAGE_CHECKS_FOLDER, folder / IMAGE_CHECKS_FOLDER)
        return folder.name, folder

    def get(self, key: str) -> Path:
        """The folder of a trial. Raises WebError if it does not exist (any more)."""
        reason = f"no trial {key!r}: only the newest {_KEPT} are kept; try the settings again"
        return real_path(or_404(self._trials().get(key), reason))

    def _trials(self) -> dict[str, Path]:
        try:
            return {path.name: path for path in self._folder.iterdir() if path.is_dir()}
        except OSError:
            return {}
