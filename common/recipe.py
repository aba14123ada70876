"""Recipes: which defaults the settings of an index and of a training have."""

from __future__ import annotations

import argparse
import contextlib
from typing import Final, Literal, get_args

Recipe = Literal["people", "original"]
"""people: what learns best from people (docs/learning-from-people.md); original: as the original project did."""

DEFAULT: Final[Recipe] = "people"


def recipe_given(default: Recipe = DEFAULT) -> Recipe:
    """The recipe that the command line asks for with --recipe; what is none is left to who parses it wholly."""
    given = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    given.add_argument("--recipe", choices=get_args(Recipe), default=default)
    with contextlib.suppress(argparse.ArgumentError):
        recipe: Recipe = given.parse_known_args()[0].recipe
        return recipe
    return default
