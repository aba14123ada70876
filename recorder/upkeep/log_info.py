"""A summary of a log, read from its end alone."""

from __future__ import annotations

import contextlib
import json
import math
from collections import Counter
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from common.location import Location
from common.untrusted import json_as
from recorder import topics
from recorder.log.findings import FlaggedRows, findings
from recorder.log.known_lag import driven_by, find_lag, kept_lag
from recorder.log.reader import Log
from recorder.log.tags import Tag, TaggedRows, tags_by_content
from recorder.rows.label_plan import goes_by_lag, plan_labels
from recorder.rows.odd_stretches import OddStretch
from recorder.rows.steering_habits import SteeringHabits, SteeringLag


@dataclass(frozen=True)
class TopicInfo:
    topic: str
    schema: str
    messages: int
    per_second: float


@dataclass(frozen=True)
class LogInfo:
    """The content of `bc-log info`."""

    path: str
    size_bytes: int
    start: str  # UTC, ISO 8601: of the first message, or of the file if time was simulated; "" if unknown
    duration_s: float  # from the first message to the last
    driven_s: float | None  # of all drives, without pauses; None: its rows were not measured
    topics: list[TopicInfo]  # rates over the driven time, if known
    session: dict[str, str]  # its origin
    drives: int | None
    flags: dict[str, int] | None  # the number of rows with each flag
    stretches: list[FlaggedRows]  # the first ones
    odd: list[OddStretch] | None  # the first ones not tagged fine; None: its rows were not measured
    steering: SteeringHabits | None  # None: its rows were not measured, or it has none
    lag: SteeringLag | None  # of the steering; None: not measured, or its pictures do not show it
    lacks_lag: bool  # labels depend on the lag, but it was never measured
    labels: str  # the labels that an index makes; empty if unknown
    picture_sizes: dict[str, str]  # sizes and counts, of each topic with several sizes
    tags: list[Tag]
    stale_tags: int  # tags of an earlier log with this name
    notice: str  # of an unfinished log
    is_ours: bool  # written by this toolkit
    meant_gaps: list[int] = field(default_factory=list)  # the rows after gaps that its events explain

    @property
    def rows(self) -> int:
        return next((topic.messages for topic in self.topics if topic.topic == topics.VEHICLE), 0)

    @property
    def odd_rows(self) -> dict[str, int]:
        """The number of odd rows by kind, most first."""
        rows = Counter[str]()
        for stretch in self.odd or ():
            rows[stretch.kind] += stretch.rows
        return dict(rows.most_common())

    @property
    def driver(self) -> str:
        """The run that drove, or the driver, or the source; a person's device in brackets. Empty if unknown."""
        names = (self.session.get(name, "") for name in ("run", "driver", "source"))
        name = next((name for name in names if name), "")
        device = self.steering.device if self.steering else ""
        return f"{name} ({device})" if device else name

    @property
    def length_s(self) -> float:
        """The driving time, or the time from the first message to the last."""
        return self.duration_s if self.driven_s is None else self.driven_s

    def as_json(self) -> str:
        """One line of JSON, an object."""
        tags = [tag._asdict() for tag in self.tags]
        return json.dumps({**asdict(self), "tags": tags}, allow_nan=False)


def describe(
    place: Location | Log, *, look: bool = False, with_tags: bool = True, with_kept_lag: bool = True
) -> LogInfo:
    """Describe an open log, or the log at a place. `look` measures an unknown lag of the steering in some
    pictures. `with_tags`, `with_kept_lag`: also read the files next to the log. Raises LogError if the log or its
    tags cannot be read; StoreError."""
    with contextlib.nullcontext(place) if isinstance(place, Log) else Log(place) as log:
        first_ns, last_ns = log.time_range_ns
        duration_s = (last_ns - first_ns) / 1e9
        counts, schemas = log.counts, log.schemas
        quality, found = log.read_metadata(topics.QUALITY_METADATA), findings(log)
        by_content = tags_by_content(log.path) if with_tags else {}
        fingerprint = log.fingerprint if by_content else ""  # not computed without tags
        rate_s = found.driven_s if found else duration_s
        tags = sorted(by_content.get(fingerprint, ()))
        lag = found.lag if found else None
        goes_by = found is not None and goes_by_lag(found.steering, driven_by(log))
        if lag is None and goes_by:
            lag = (kept_lag(log) if with_kept_lag else None) or (find_lag(log) if look else None)
        return LogInfo(
            path=str(log.path),
            size_bytes=log.size,
            start=_start(log, first_ns) if any(counts.values()) else "",
            duration_s=duration_s,
            driven_s=found.driven_s if found else None,
            topics=[
                TopicInfo(name, schemas[name], counts[name], counts[name] / rate_s if rate_s > 0 else 0.0)
                for name in sorted(counts)
            ],
            session=log.metadata,
            drives=found.drives if found else None,
            flags=found.flags if found else None,
            stretches=found.stretches if found else [],
            odd=TaggedRows(tags).untagged(found.odd) if found else None,
            steering=found.steering if found else None,
            lag=lag.lag if lag else None,
            lacks_lag=lag is None and goes_by,
            labels=str(plan_labels(found.steering, lag, driven_by(log))) if found else "",
            picture_sizes=json_as(quality.get("picture_sizes", ""), dict[str, str]) or {},
            tags=tags,
            stale_tags=sum(len(tags) for content, tags in by_content.items() if content != fingerprint),
            notice=log.notice,
            is_ours=log.is_ours,
            meant_gaps=found.meant_gaps if found else [],
        )


def _start(log: Log, first_ns: int) -> str:
    """The start of a log. With simulated time, all recordings begin at the same moment: then the file's time."""
    session = log.metadata
    is_simulated = session.get("source") == "simulator" and session.get("driver") != "human"
    seconds = first_ns // 10**9
    if is_simulated or session.get("source") == "gymnasium":
        if not isinstance(log.path, Path):
            return ""
        seconds = int(log.path.stat().st_mtime)
    return datetime.fromtimestamp(seconds, UTC).isoformat() if first_ns < 2**62 else ""


def set_speeds_mph(log: Log) -> tuple[float, ...]:
    """The set speeds of a session's driver, from its log; none for people."""
    stored = f"{log.metadata.get('drive.speed', '')} {log.metadata.get('set_speed_mph', '')}".split()
    try:
        speeds = [float(speed) for speed in stored]
    except ValueError:
        return ()
    return tuple(sorted({speed for speed in speeds if 0 < speed < math.inf}))


def first_picture_sizes(log: Log) -> dict[str, tuple[int, int]] | None:
    """Width and height of the first picture of each camera's topic, as the log's writer noted them; None if it did
    not."""
    stored = log.read_metadata(topics.QUALITY_METADATA).get("first_picture_px", "")
    return json_as(stored, dict[str, tuple[int, int]])
