"""The first page: what the project has, and the one next step."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from common.errors import counted, printable
from dataset.samples.samples_format import SAMPLES_NAME
from web.folders.project_folders import PLACES, Place
from web.logs.session_cards import IndexState, SessionCard
from web.pages.workbench import Workbench
from web.runs.run_cards import RunCard, badge_of
from web.server.templates import page

_NEWEST: Final = 3  # of each kind
_SHOWN_ROWS: Final = 150
"""Of the newest drive, from its middle on: a quarter of a minute at ten rows a second."""


class Suggestion(NamedTuple):
    """The next step: a button, why it is the next one, and where it leads; with `form`, it starts that job."""

    button: str
    why: str
    address: str
    form: str = ""


class Moving(NamedTuple):
    name: str
    address: str
    first_row: int
    rows: int
    version: str


def home_routes(bench: Workbench) -> list[Route]:
    def home(request: Request) -> Response:
        live = bench.sessions_version(), bench.runs_version(), bench.drives_version()  # as data-live names them
        cards = {place: bench.cards.cards(place) for place in PLACES}
        runs = bench.runs.cards()
        has_samples = (bench.folders.index / SAMPLES_NAME).exists()
        recorded_s = sum(card.info.length_s for card in cards["sessions"] if card.info)
        return page(
            "home.html",
            live="; ".join(live),
            project=printable(Path.cwd().name),
            is_new=not any(cards.values()) and not runs,
            minutes=recorded_s / 60,
            recordings=len(cards["sessions"]),
            networks=len(runs),
            best=_best(runs),
            moving=_moving(cards),
            newest={place: _newest(cards[place]) for place in PLACES},
            newest_networks=[
                (card, badge_of(card.summary)) for card in sorted(runs, key=_written, reverse=True)[:_NEWEST]
            ],
            step=next_step(cards["sessions"], runs, has_samples=has_samples),
        )

    return [Route("/", home)]


def next_step(sessions: Sequence[SessionCard], runs: Sequence[RunCard], *, has_samples: bool) -> Suggestion:
    """The most useful next step of a project with these recordings and networks."""
    for card in sessions:
        if card.state in ("unfinished", "damaged"):
            return Suggestion(f"Look after {card.name}", f"the recording is {card.state}", f"/sessions/{card.key}")
    newest = max(runs, key=_written, default=None)
    if newest is not None and newest.is_training:
        return Suggestion("Watch it learn", f"a network is learning: {newest.name}", f"/runs/{newest.key}")
    readable = [card for card in sessions if card.info and not card.is_recording]
    if not readable:
        return Suggestion("Take the wheel", "a network learns from what you drive", "/wheel")
    missing = [card for card in readable if card.index.state in (IndexState.MISSING, IndexState.CHANGED)]
    if has_samples and missing:
        why = f"no network has learnt from {counted(len(missing), 'new recording')} yet"
        return Suggestion("Train a network", why, "/runs", "train")
    if newest is None or newest.summary is None:
        why = f"from {counted(len(readable), 'recording')}; it takes a few minutes"
        return Suggestion("Train a network", why, "/runs", "train")
    summary = newest.summary
    if not summary.kept_epoch:
        why = f"no epoch of {newest.name} has ended"
        return Suggestion("Continue its training", why, f"/runs/{newest.key}")
    driven = summary.drives or summary.supervised
    if not driven:
        why = f"the network {newest.name} has not driven yet"
        return Suggestion("Watch it drive", why, f"/wheel?driver=run&run={newest.key}")
    exits = sum(int(drive["interventions"]) for drive in driven)
    if exits:
        why = f"the network {newest.name} needed help {counted(exits, 'time')}; it learns from where you take over"
        return Suggestion("Drive with it, and take over", why, f"/wheel?driver=run&run={newest.key}")
    why = f"the network {newest.name} needed no help so far"
    return Suggestion("Try it on another road", why, f"/jobs?{urlencode({'start': 'drive', 'run': newest.name})}")


def _written(card: RunCard) -> tuple[bool, str]:
    return card.is_training, card.summary.written_at if card.summary else ""


def _best(runs: Sequence[RunCard]) -> dict[str, Any] | None:
    """The best drive of any network: the fewest interventions a metre, then the longest. None without drives."""
    drives = [
        {**drive, "network": card.name, "key": card.key}
        for card in runs
        if card.summary
        for drive in card.summary.drives or card.summary.supervised
        if drive["distance_m"] > 0
    ]
    return min(
        drives,
        key=lambda drive: (drive["interventions"] / drive["distance_m"], -drive["distance_m"]),
        default=None,
    )


def _changed_s(card: SessionCard) -> float:
    """When the log was written: a simulated drive's own clock has no date."""
    try:
        return card.path.stat().st_mtime
    except OSError:  # deleted meanwhile
        return 0.0


def _newest(cards: Sequence[SessionCard]) -> list[SessionCard]:
    """The newest logs that have pictures, the newest first."""
    whole = [card for card in cards if card.info and card.info.rows and not card.is_recording]
    return sorted(whole, key=_changed_s, reverse=True)[:_NEWEST]


def _moving(cards: dict[Place, list[SessionCard]]) -> Moving | None:
    shown = [(place, card) for place in PLACES for card in _newest(cards[place])[:1]]
    if not shown:
        return None
    place, card = max(shown, key=lambda entry: _changed_s(entry[1]))
    rows = card.info.rows if card.info else 0
    first = max(0, rows // 2 - _SHOWN_ROWS // 2)
    return Moving(card.name, f"/{place}/{card.key}", first, min(_SHOWN_ROWS, rows), card.version)
