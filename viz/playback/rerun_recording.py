"""A log as a Rerun recording: first its drawings, then its pictures and all other topics."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from common import Skipped, UserError
from common.errors import printable
from common.files import refuse_existing
from common.progress import track
from recorder import Log, LogError
from recorder.log.reader import Message
from recorder.topics import EVENTS, POSE, TOPICS
from recorder.upkeep.recover import recover
from viz.playback.blueprint import CENTER, Curve, log_layout
from viz.playback.curves import (
    Drawing,
    Numbers,
    Values,
    curve_values,
    frame_size,
    number_fields,
    numbers_of,
    prediction_curves,
)
from viz.playback.log_chunks import protobuf_topics, read_chunks
from viz.playback.prediction_log import prediction_topics, read_predictions
from viz.rrd_file import rrd_file
from viz.timelines import Times, log_clock

_ROWS_AT_ONCE: Final = 500  # unsent rows, some megabytes of pictures: more would only take memory


@dataclass(frozen=True)
class PredictionLayer:
    """Predictions of networks that are shown with a log."""

    runs: Sequence[str]  # names of the runs
    attention: bool  # with attention maps
    send: Callable[[rr.RecordingStream, Drawing, Callable[[], object]], object]
    """Sends or draws the predictions in a recording. The third argument is `flush` of `PreparedRecording.send`."""


class DrawnMessages:
    """The messages of a log that are drawn, without messages of other types on topics of the same names."""

    def __init__(self, log: Log) -> None:
        """Reads all numbers. Raises LogError if the log is damaged."""
        log.messages(EVENTS)  # first the index, which shows its own progress bar
        self._log = log
        self.numbers = {topic: _columns(log, topic) for topic in _of_registry(log) if topic != EVENTS}
        """Log times (N,) in ns and values (N,) of each field, by topic."""

    @cached_property
    def picture_size(self) -> tuple[int, int] | None:
        """Width and height of the centre camera's first readable picture."""
        log = self._log
        if CENTER not in topics_with_messages(log) or not _is_ours(log, CENTER):
            return None
        pictures = log.pictures(CENTER)
        for place in zip(pictures.offset, pictures.length, pictures.chunk, strict=True):
            with contextlib.suppress(LogError):  # a damaged chunk is reported when pictures are sent
                return frame_size(log.read(*map(int, place)))
        return None

    @property
    def poses(self) -> tuple[Times, Numbers]:
        """As an entry of `numbers`; empty without poses."""
        return self.numbers.get(POSE, (np.zeros(0, np.int64), numbers_of(POSE, [])))

    @cached_property
    def events(self) -> tuple[Times, list[Any]]:
        """Log times (N,) in ns, and N contents."""
        if EVENTS not in _of_registry(self._log):
            return _split(())
        return _split(track(self._log.decoded(EVENTS), f"reading {EVENTS}", self._log.counts[EVENTS]))


@dataclass(frozen=True)
class PreparedRecording:
    """A recording that is ready to send: its drawings are read and checked; pictures are checked when sent."""

    name: str
    layout: rrb.Blueprint
    send: Callable[[rr.RecordingStream, Callable[[], object], int], object]
    """Sends to a recording. The second argument, `flush`, waits until all data is received, and may raise an
    exception to stop. The third argument is `every` of `read_chunks`."""
    notices: Sequence[str]  # of logs that were never finished
    recording_id: str | None = None  # in a file: equal for equal logs
    at_s: float | None = None  # the recording opens this many seconds after its start; None: at the start
    skipped: Skipped = field(default_factory=Skipped)  # filled during sending


def save_rrd(path: Path, rrd: Path, *, overwrite: bool = False) -> str:
    """Write the log at `path`, its curves and its layout to the file `rrd`, without a window.

    An unfinished log is written up to its last complete chunk. Returns the notices about the log; empty for a
    sound, finished log. Raises LogError if the log cannot be read; UserError if `rrd` exists and may not be
    overwritten, or if the disk is full.
    """
    refuse_existing(rrd, overwrite)
    with prepare_log(path) as prepared:
        save_prepared(prepared, rrd, overwrite=overwrite)
        return "\n".join([*prepared.notices, *prepared.skipped.lines()])


def save_prepared(prepared: PreparedRecording, rrd: Path, *, overwrite: bool) -> None:
    """Write a recording to the file `rrd`. Raises UserError as `save_rrd` does."""
    named = prepared.recording_id
    with rrd_file(rrd, overwrite=overwrite, recording_id=named, layout=prepared.layout) as file:
        file.recording.send_recording_name(prepared.name)
        prepared.send(file.recording, file.recording.flush, 1)


@contextlib.contextmanager
def prepare_log(
    path: Path, predictions: PredictionLayer | None = None, at_s: float | None = None
) -> Iterator[PreparedRecording]:
    """Prepare the log at `path`: first the curves are sent, then the pictures, then predictions. The recording
    opens `at_s` seconds after its start.

    Raises LogError for a damaged log, UserError if the log is shorter than `at_s`.
    """
    with open_whole_log(path) as (log, notice):
        check_moment(at_s, [(path, log)])
        drawn = DrawnMessages(log)  # before anything is sent: if the numbers are damaged, nothing is shown
        skipped = Skipped()

        def send(recording: rr.RecordingStream, flush: Callable[[], object], every: int) -> None:
            clock = log_clock(log.time_range_ns[0])
            drawing = Drawing(recording, clock)
            draw(drawn, drawing)
            for curve, time_ns, values in predicted_curves(log):
                drawing.curve(curve, time_ns, values)
            chunks = read_chunks(log, drawn_topics(log), clock, skipped, every=every)
            send_chunks(chunks, recording, flush)
            if predictions is not None:
                predictions.send(recording, drawing, flush)

        runs = predictions.runs if predictions is not None else ()
        attention = runs if predictions is not None and predictions.attention else ()
        layout = log_layout(topics_with_messages(log), runs, attention, at_s=at_s)
        recording_id = f"{path.name}-{log.fingerprint[:12]}"
        notices = [notice] if notice else []
        yield PreparedRecording(path.name, layout, send, notices, recording_id, at_s, skipped)


@contextlib.contextmanager
def open_whole_log(path: Path) -> Iterator[tuple[Log, str]]:
    """Open the log at `path`, or a copy of an unfinished log or of one without indexes. Yields the log and its
    notice.

    Rerun's reader refuses a log without a sound end, and finds only what is indexed. Raises LogError if the log
    cannot be read, UserError for a name that Rerun cannot open.
    """
    if printable(str(path)) != str(path):
        raise UserError(f"{path}: Rerun opens only names in UTF-8; rename the log")
    with Log(path, shows_progress=True) as log:
        if log.is_indexed:
            yield log, ""
            return
        with tempfile.TemporaryDirectory(prefix="bc-play-") as folder:
            whole = recover(path, Path(folder) / "whole.mcap")
            with Log(whole.path) as recovered:
                yield recovered, log.notice or "; ".join([f"{path}: {line}" for line in whole.skipped.lines()])


def curves(log: Log) -> Iterator[tuple[Curve, Times, Values]]:
    """The curves of a log, each with log times (N,) in ns and values (N,)."""
    for topic, (time_ns, numbers) in DrawnMessages(log).numbers.items():
        yield from curve_values(topic, time_ns, numbers)
    yield from predicted_curves(log)


def draw(drawn: DrawnMessages, drawing: Drawing) -> None:
    for topic, (time_ns, numbers) in drawn.numbers.items():  # all curves first
        drawing.send_numbers(topic, time_ns, numbers)
    drawing.picture_size = drawn.picture_size or drawing.picture_size
    for topic, (time_ns, numbers) in drawn.numbers.items():
        drawing.send_arcs(topic, time_ns, numbers)
    drawing.send(EVENTS, *drawn.events)
    drawing.finish()


def topics_with_messages(log: Log) -> list[str]:
    return [topic for topic, count in log.counts.items() if count]


def drawn_topics(log: Log) -> list[str]:
    """The topics of a log that are drawn, which Rerun's reader need not read."""
    return [*_of_registry(log), *prediction_topics(log)]


def send_chunks(chunks: Generator[Chunk], recording: rr.RecordingStream, flush: Callable[[], object]) -> None:
    """Send chunks no faster than the viewer receives them, so that they do not pile up in this process."""
    rows = 0
    with contextlib.closing(chunks):  # closes their progress bar before an error is printed
        for chunk in chunks:
            recording.send_chunks(chunk)
            rows += len(chunk)
            if rows >= _ROWS_AT_ONCE:
                flush()
                rows = 0
        flush()


def check_moment(at_s: float | None, logs: Iterable[tuple[Path, Log]]) -> None:
    """Raise UserError if all logs are shorter than `at_s`."""
    if at_s is None:
        return
    lengths = {path: 1e-9 * (log.time_range_ns[1] - log.time_range_ns[0]) for path, log in logs}
    longest = max(lengths, key=lengths.__getitem__)
    if at_s > lengths[longest]:
        raise UserError(f"--at {at_s:g}: {longest} is {lengths[longest]:.1f} s long; give fewer seconds")


def predicted_curves(log: Log) -> Iterator[tuple[Curve, Times, Values]]:
    """The curves of the predictions in a log. Raises LogError if the log is damaged."""
    for number, predictions in enumerate(read_predictions(log)):
        yield from prediction_curves(predictions, number)


def _of_registry(log: Log) -> list[str]:
    """The toolkit's drawn topics that this log has, without topics of the same name and another type."""
    counts = log.counts
    return [
        name for name, topic in TOPICS.items() if not topic.is_picture and counts.get(name) and _is_ours(log, name)
    ]


def _is_ours(log: Log, topic: str) -> bool:
    return protobuf_topics(log).get(topic) == TOPICS[topic].message.name


def _columns(log: Log, topic: str) -> tuple[Times, Numbers]:
    fields = number_fields(topic)
    table = log.numbers(topic, fields)
    return table["log_time_ns"].to_numpy(), {name: table[name].to_numpy() for name in fields}


def _split(messages: Iterable[tuple[Message, Any]]) -> tuple[Times, list[Any]]:
    pairs = list(messages)
    return np.array([message.log_time_ns for message, _ in pairs], np.int64), [content for _, content in pairs]
