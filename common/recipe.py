"""Recipes: sets of defaults for the settings of an index and of a training."""

from __future__ import annotations

import argparse
import contextlib
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
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--recipe", choices=get_args(Recipe), default=default)
    with contextlib.suppress(argparse.ArgumentError):
        recipe: Recipe = parser.parse_known_args()[0].recipe
        return recipe
    return default
