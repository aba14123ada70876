"""Whole numbers in untrusted text, such as an address, a form or a csv."""

from __future__ import annotations


def whole_number(text: str, max_digits: int = 15) -> int | None:
    """Return the number that a text of ASCII digits stands for; None for any other text, and for more digits.

    `int` itself accepts signs, spaces and underscores, and raises ValueError for more than 4,300 digits.
    """
    return int(text) if text.isascii() and text.isdigit() and len(text) <= max_digits else None
