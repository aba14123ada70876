"""The card of a dataset, its README.md: content, drivers, processing and licence."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from common.errors import counted
from common.markdown import as_markdown
from common.versions import version_of
from recorder.lerobot.dataset_format import PREVIOUS_NAMES, SPLIT, STATE

CARD_PATH: Final = "README.md"
NO_LICENCE: Final = "not stated: ask whoever recorded it before you use it"


@dataclass(frozen=True)
class CardSession:
    """The card's entry of one log."""

    name: str
    fingerprint: str
    session: Mapping[str, str]  # of the log's metadata: where it comes from
    rows: int
    episodes: int
    excluded: int


def card(
    info: Mapping[str, Any],
    sessions: Sequence[CardSession],
    *,
    task: str,
    licence: str | None,
    picture: str,
    rate_hz: float,
    max_steering_deg: float | None,
) -> str:
    """The text of a card. `picture`: the file name of an example."""
    is_video = info["video_path"] is not None
    full = "an unknown angle" if max_steering_deg is None else f"{max_steering_deg:g} degrees"
    header = [
        "---",
        *([f"license: {json.dumps(licence)}"] if licence else []),
        "task_categories:",
        "- robotics",
        "tags:",
        "- LeRobot",
        "- imitation-learning",
        "- driving",
        "configs:",
        "- config_name: default",
        "  data_files: data/*/*.parquet",
        "---",
    ]
    frames, episodes = info["total_frames"], info["total_episodes"]
    names = ", ".join(name for name in info["features"] if name.startswith("observation.images."))
    pictures = (
        f"Pictures ({names}): videos in H.264, encoded anew from the camera's pictures, which are not in here."
        if is_video
        else f"Pictures ({names}): in the parquet files, byte for byte as the camera or simulator made them."
    )
    rows = [
        f"| {as_markdown(each.name)} | {as_markdown(_origin(each.session))} | {each.rows:,} | {each.episodes:,} |"
        f" {each.excluded:,} | `{each.fingerprint[:16]}` |"
        for each in sessions
    ]
    of_split = (
        "- `split`, also in `meta/episodes`: `train`, or `validation` for whole stretches of time that were held"
        " out. An episode is on one side."
    )
    has_speed = "speed_mph" in info["features"][STATE]["names"]
    speed = "`speed_mph`, miles an hour (1 is 0.44704 m/s), and " if has_speed else ""
    split = [of_split] if SPLIT in info["features"] else []
    lines = [
        *header,
        "",
        "# Driving, for behavioural cloning",
        "",
        f"![A picture of it]({picture})",
        "",
        f"{counted(frames, 'frame')} of driving in {counted(episodes, 'episode')}, about {rate_hz:.3g} a second."
        f" Task: {as_markdown(task)}",
        "",
        "## What is in it",
        "",
        f"- {pictures}",
        f"- `action`: `steering` from -1 (left) to 1 (right), where 1 is {full} of the front"
        " wheels; `throttle`, `brake`, 0 to 1.",
        f"- `observation.state`: {speed}{_listed(PREVIOUS_NAMES)}: what was in force before the frame's `action`,"
        " from the row before it in its log. They are 0 where a drive begins.",
        f"- `timestamp` is `frame_index / {info['fps']}`, as the format has it. The true time of each frame is"
        " `log_time_ns`, nanoseconds since 1970 where the session knew the date.",
        "- `log_fingerprint`, `log_row`: the log and the row that a frame comes from. `log_vehicle`: steering,"
        " throttle, brake and speed with all the digits of the log.",
        "- An episode is a drive without a pause of more than a second.",
        *split,
        "",
        "## Who drove, and what was left out",
        "",
        "| session | where it comes from | frames | episodes | rows excluded by hand | fingerprint |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        "## How it was made",
        "",
        f"Exported by behavioural-cloning-toolkit {version_of()} (`bc-log export --lerobot`) in the format"
        f" {info['codebase_version']} of [LeRobot](https://github.com/huggingface/lerobot);"
        " `bc-record NAME --from FOLDER` makes a log of it again.",
        "",
        "## Licence",
        "",
        licence or NO_LICENCE.capitalize() + ".",
        "",
    ]
    return "\n".join(lines)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _origin(session: Mapping[str, str]) -> str:
    parts = [
        f"{name}: {session[name]}"
        for name in ("source", "track", "driver", "run", "recording")
        if session.get(name)
    ]
    return ", ".join(parts) or "unknown"
