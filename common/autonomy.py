"""Autonomy: the share of the time that a network drove without help."""

from __future__ import annotations

from typing import Final

INTERVENTION_COST_S: Final = 6.0
"""A person takes over, steers back, restarts the system: Bojarski et al. 2016 (arXiv 1604.07316), section 7.1."""


def autonomy_percent(interventions: int, driven_s: float) -> float:
    """The autonomy over `driven_s` seconds, more than 0, in 0..100."""
    return 100.0 * max(0.0, 1.0 - INTERVENTION_COST_S * interventions / driven_s)
