"""Whole numbers in untrusted text, such as an address, a form or a csv."""

from __future__ import annotations


def whole_number(text: str, max_digits: int = 15) -> int | None:
    """Parse a text of at most `max_digits` ASCII digits; None for any other text.

    `int` itself accepts signs, spaces and underscores, and raises ValueError for more than 4,300 digits.
    """
    return int(text) if text.isascii() and text.isdigit() and len(text) <= max_digits else None
