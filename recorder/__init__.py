"""The log: its messages, its writer and reader, and the recordings that become logs."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from typing import TYPE_CHECKING

from common.lazy import lazy_names
from recorder.errors import LogError, RecordingError
from recorder.log import Log, Pictures

if TYPE_CHECKING:
    from recorder.record import Imported, import_udacity
    from recorder.writer import LogWriter

__all__ = ["Imported", "Log", "LogError", "LogWriter", "Pictures", "RecordingError", "import_udacity"]

# training reads logs where what writes them is not installed
__getattr__, __dir__ = lazy_names(
    __name__,
    {"Imported": "recorder.record", "LogWriter": "recorder.writer", "import_udacity": "recorder.record"},
)
