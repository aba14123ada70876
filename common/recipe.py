"""Recipes: sets of defaults for the settings of an index and of a training."""

from __future__ import annotations

import argparse
import contextlib
from typing import Final, Literal, get_args

Recipe = Literal["altered", "people", "original"]
"""people: best for recordings of people (docs/studies/learning-from-people.md); altered: the same, with pictures
altered anew in every epoch; original: as the original did."""

IndexRecipe = Literal["people", "original"]
"""`altered` and `people` learn from the same index."""

DEFAULT: Final[Recipe] = "altered"


def recipe_given(default: Recipe = DEFAULT) -> Recipe:
    """The recipe that --recipe names on the command line; a wrong one is reported where all flags are parsed."""
    given = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    given.add_argument("--recipe", choices=get_args(Recipe), default=default)
    with contextlib.suppress(argparse.ArgumentError):
        recipe: Recipe = given.parse_known_args()[0].recipe
        return recipe
    return default
