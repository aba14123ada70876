"""The log: its messages, its writer and reader, and the recordings that become logs."""

from typing import TYPE_CHECKING

from common.lazy import lazy_names
from recorder.errors import LogError, RecordingError

if TYPE_CHECKING:
    from recorder.log.reader import Log
    from recorder.log.writer import LogWriter
    from recorder.mcap.picture_places import Pictures
    from recorder.sources.import_recording import import_udacity
    from recorder.sources.imported_rows import Imported

__all__ = ["Imported", "Log", "LogError", "LogWriter", "Pictures", "RecordingError", "import_udacity"]

# training reads logs where what writes them is not installed; flags and errors need no NumPy
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Imported": "recorder.sources.imported_rows",
        "Log": "recorder.log.reader",
        "LogWriter": "recorder.log.writer",
        "Pictures": "recorder.mcap.picture_places",
        "import_udacity": "recorder.sources.import_recording",
    },
)
