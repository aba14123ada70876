"""The log: its messages, its writer and reader, and the recordings that become logs."""

from recorder.errors import LogError, RecordingError
from recorder.log import Log, Pictures
from recorder.record import Imported, import_udacity
from recorder.writer import LogWriter

__all__ = ["Imported", "Log", "LogError", "LogWriter", "Pictures", "RecordingError", "import_udacity"]
