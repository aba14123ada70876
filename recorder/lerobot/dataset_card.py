"""The card of a dataset, its README.md: content, drivers, processing and licence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from common.markdown import rendered
from common.versions import version_of
from recorder.lerobot.dataset_format import PREVIOUS_NAMES, SPLIT, STATE
from recorder.lerobot.export_plan import ExportPlan

CARD_PATH: Final = "README.md"
NO_LICENCE: Final = "not stated: ask whoever recorded it before you use it"


@dataclass(frozen=True)
class CardSession:
    name: str
    fingerprint: str
    session: Mapping[str, str]  # the log's metadata about its origin
    rows: int
    episodes: int
    excluded: int

    @property
    def origin(self) -> str:
        named = ("source", "track", "driver", "run", "recording")
        parts = [f"{name}: {self.session[name]}" for name in named if self.session.get(name)]
        return ", ".join(parts) or "unknown"


def card(
    info: Mapping[str, Any],
    sessions: Sequence[CardSession],
    plan: ExportPlan,
    *,
    task: str,
    licence: str | None,
    picture: str,
) -> str:
    """The text of a card. `picture`: the file name of an example."""
    max_deg = plan.max_steering_deg
    return rendered(
        "recorder",
        "dataset_card.md.jinja",
        info=info,
        sessions=sessions,
        task=task,
        licence=licence,
        no_licence=NO_LICENCE,
        picture=picture,
        rate_hz=plan.rate_hz,
        cameras=", ".join(name for name in info["features"] if name.startswith("observation.images.")),
        full_lock="an unknown angle" if max_deg is None else f"{max_deg:g} degrees",
        has_speed="speed_mph" in info["features"][STATE]["names"],
        has_split=SPLIT in info["features"],
        previous=", ".join(f"`{name}`" for name in PREVIOUS_NAMES),
        version=version_of(),
    )
