"""Recipes: sets of defaults for the settings of an index and of a training. Flags that choose defaults."""

from __future__ import annotations

import itertools
import sys
from typing import Final, Literal, get_args

Recipe = Literal["large-steps", "altered", "people", "original"]
"""`original`: the settings of the original implementation. `people`: for recordings of people
(docs/studies/learning-from-people.md). `altered`: as `people`, but with new random alterations of the pictures in
every epoch, the same light in all pictures, and the weights of the last epoch. `large-steps`: as `altered`, but a
tenth of the time: four steps in place of one, each ten times as large, and fewer passes
(docs/studies/speedrun.md)."""

IndexRecipe = Literal["people", "original"]
"""`large-steps`, `altered` and `people` learn from the same index."""

DEFAULT: Final[Recipe] = "large-steps"


def recipe_given(default: Recipe = DEFAULT) -> Recipe:
    """The value of --recipe on the command line; `default` if it is absent or wrong. The parser of all flags
    reports a wrong value."""
    given = value_given("--recipe")
    return next((recipe for recipe in get_args(Recipe) if recipe == given), default)


def value_given(flag: str) -> str | None:
    """The value of a flag on the command line, before its other words are parsed; None if it is absent."""
    value = None
    for word, following in itertools.pairwise([*sys.argv[1:], ""]):
        name, is_joined, joined = word.partition("=")
        if name == flag:
            value = joined if is_joined else following
    return value
