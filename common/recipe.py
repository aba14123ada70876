"""Recipes: sets of defaults for the settings of an index and of a training."""

from __future__ import annotations

import argparse
import contextlib
from typing import Final, Literal, TypeVar, get_args

Recipe = Literal["altered", "people", "original"]
"""people: best for recordings of people (docs/studies/learning-from-people.md); altered: the same, with pictures
altered anew in every epoch; original: as the original did."""

IndexRecipe = Literal["people", "original"]
"""`altered` and `people` learn from the same index."""

DEFAULT: Final[Recipe] = "altered"
INDEX_DEFAULT: Final[IndexRecipe] = "people"

Known = TypeVar("Known", Recipe, IndexRecipe)


def index_recipe(recipe: Recipe) -> IndexRecipe:
    """The recipe of the index that a training by `recipe` learns from."""
    return "original" if recipe == "original" else "people"


def recipe_given(default: Recipe = DEFAULT) -> Recipe:
    """The training recipe that --recipe names on the command line; a wrong one is reported where all flags are
    parsed."""
    return _given(default, get_args(Recipe))


def index_recipe_given() -> IndexRecipe:
    """The same of an index."""
    return _given(INDEX_DEFAULT, get_args(IndexRecipe))


def _given(default: Known, known: tuple[str, ...]) -> Known:
    flags = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    flags.add_argument("--recipe", choices=known, default=default)
    with contextlib.suppress(argparse.ArgumentError):
        recipe: Known = flags.parse_known_args()[0].recipe
        return recipe
    return default
