"""Autonomy: the share of the time that a network drove without help."""

from __future__ import annotations

from typing import Final

INTERVENTION_COST_S: Final = 6.0
"""Time in which a person takes over, steers back and restarts the system: Bojarski et al. 2016 (arXiv 1604.07316),
section 7.1."""


def autonomy_percent(interventions: int, driven_s: float) -> float:
    """The autonomy in percent (0..100) over `driven_s` seconds, which must be more than 0."""
    return 100.0 * max(0.0, 1.0 - INTERVENTION_COST_S * interventions / driven_s)
