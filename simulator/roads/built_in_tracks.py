"""The two built-in roads.

Both halves of a road have the same kinds of bends and slopes, but other bends and slopes. Some looks appear only
in the second half. So a network trained on the first half has to generalise to drive the lap.
"""

from __future__ import annotations

from dataclasses import replace

from simulator.roads.road_stretches import Edge, Look, Stretch

# The lake: a wide single lane.
_KERB = Edge("kerb", 0.3)
_STRIPED = Edge("striped", 0.2)
_DIRT = Edge("dirt", 0.5, 36.0)
_CUT = Edge("dirt", 5.0, 20.0)  # the road cuts into a hill
_SHORE = Edge("kerb", -2.5, 12.0)
_SHORE_DIRT = Edge("dirt", -2.5, 12.0)
_LAKE = Look("asphalt", _KERB, _KERB, 4.6)
_BRIDGE = Look("cobbles", Edge("wall", -4.0, 0.0), Edge("wall", -4.0, 0.0), 4.4, light=1.05)

LAKE = (
    Stretch(105, 0, 0.0, _LAKE),
    Stretch(50, 60, 0.0, replace(_LAKE, left=_STRIPED)),
    Stretch(35, 0, 0.005, replace(_LAKE, right=_DIRT)),
    Stretch(38, -65, 0.01, replace(_LAKE, right=_STRIPED, left=_DIRT)),
    Stretch(60, 0, 0.01, replace(_LAKE, left=_DIRT, right=_CUT, light=0.9, shade=0.35)),
    Stretch(60, 110, 0.0, replace(_LAKE, left=_CUT, right=_KERB)),
    Stretch(20, 0, -0.01, replace(_LAKE, left=_SHORE, right=_SHORE)),
    Stretch(45, 55, 0.0, replace(_LAKE, left=_SHORE, right=_DIRT)),
    Stretch(75, 0, 0.0, _BRIDGE),
    Stretch(50, -40, 0.01, replace(_LAKE, right=_STRIPED, surface="worn", left=Edge("grass", 0.4))),
    # The second half, with longer stretches of worn asphalt, grass edges and shady wood.
    Stretch(40, 0, 0.01, replace(_LAKE, surface="worn", left=_KERB, right=_DIRT, light=0.85, shade=0.4)),
    Stretch(60, 120, 0.0, replace(_LAKE, surface="worn", left=_STRIPED, right=_DIRT)),
    Stretch(40, 0, -0.01, replace(_LAKE, left=Edge("grass", 0.4), right=_CUT)),
    Stretch(42, -80, -0.01, replace(_LAKE, left=_DIRT, right=Edge("grass", 0.3))),
    Stretch(60, 0, 0.0, replace(_LAKE, left=_SHORE_DIRT, right=_KERB, light=1.1)),
    Stretch(50, 95, 0.0, replace(_LAKE, left=_STRIPED, right=_SHORE_DIRT, light=1.1)),
    Stretch(115, 0, 0.0, replace(_LAKE, left=_SHORE, right=_DIRT)),
    Stretch(70, 105, 0.0, _LAKE),
)

# The mountain: two narrow lanes.
_LINE = Edge("line", 0.6, 32.0)
_ROCK = Edge("line", 5.5, 20.0)
_CLIFF = Edge("line", 9.0, 12.0)
_DROP = Edge("line", -4.0, 32.0)
_ROAD = Look("asphalt", _LINE, _LINE, 3.8, dashed=True, jungle=True, light=0.85)

MOUNTAIN = (
    Stretch(40, 0, 0.02, _ROAD),
    Stretch(35, -60, 0.08, replace(_ROAD, left=_ROCK)),
    Stretch(40, 0, 0.12, replace(_ROAD, right=_ROCK, left=_DROP, shade=0.5)),
    Stretch(42, 180, 0.06, replace(_ROAD, right=_CLIFF, light=0.75)),
    Stretch(45, 0, 0.12, replace(_ROAD, right=_DROP, left=_ROCK)),
    Stretch(42, -180, 0.06, replace(_ROAD, left=_ROCK)),
    Stretch(40, 0, 0.10, replace(_ROAD, left=_ROCK, right=_DROP, light=0.7, shade=0.6)),
    Stretch(55, 90, 0.0, replace(_ROAD, left=_ROCK, right=_LINE)),
    Stretch(25, 0, -0.08, replace(_ROAD, left=_ROCK, right=_CLIFF, light=0.7)),
    Stretch(40, -45, -0.12, replace(_ROAD, right=_ROCK, left=_DROP)),
    Stretch(50, 75, 0.05, replace(_ROAD, surface="worn", left=_ROCK)),
    # The second half.
    Stretch(45, 0, 0.10, replace(_ROAD, surface="worn", left=_DROP, right=_ROCK, shade=0.5)),
    Stretch(50, 75, -0.03, replace(_ROAD, surface="worn", left=_ROCK)),
    Stretch(45, 0, -0.13, replace(_ROAD, right=Edge("grass", 0.6, 32.0), light=0.95)),
    Stretch(40, 180, -0.08, replace(_ROAD, left=_ROCK, right=_LINE, light=0.95)),
    Stretch(45, 0, -0.13, replace(_ROAD, left=_CLIFF, right=_DROP, light=0.65, shade=0.4)),
    Stretch(40, -180, -0.06, replace(_ROAD, right=_ROCK, left=_LINE)),
    Stretch(45, 0, -0.10, replace(_ROAD, left=_DROP, right=_CLIFF, light=0.8)),
    Stretch(40, 60, -0.05, replace(_ROAD, left=_ROCK)),
    Stretch(70, 0, -0.10, replace(_ROAD, surface="worn", left=_ROCK, shade=0.6)),
    Stretch(25, -40, -0.05, replace(_ROAD, right=_ROCK, left=_DROP)),
    Stretch(30, 0, 0.04, replace(_ROAD, right=_CLIFF, light=0.7)),
    Stretch(25, 40, 0.06, replace(_ROAD, left=_ROCK, light=0.95)),
    Stretch(40, 0, -0.04, replace(_ROAD, left=_ROCK)),
    Stretch(85, 165, 0.0, replace(_ROAD, left=_LINE)),
)
