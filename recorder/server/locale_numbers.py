"""Numbers as a simulator's machine writes them: .NET uses the separators and signs of the user's language.

Mono (in Unity) has 207 cultures. With the format "N4":

- The decimal separator is `.`, `,` or, in Persian, `/`.
- Thousands are separated by `,`, `.`, a non-breaking space, or an apostrophe.
- The minus is before the number, in Croatian with a space, or after it in Arabic and Persian: `0.2167-`,
  `10/9014`.
- Digits are 0 to 9.

Newer .NET uses other signs for these languages (U+066B, U+066C, U+2212, with marks of the direction of writing).
All cultures read a leading minus with their own decimal separator. None reads a trailing minus.
"""

from __future__ import annotations

import re
from typing import Final

POINT: Final = "."
_DECIMALS: Final = ".,/\u066b"
_THOUSANDS: Final = ".,' \u00a0\u202f\u2019\u066c"
_INVISIBLE: Final = re.compile("[\u200e\u200f\u061c]")  # marks of the direction of writing
_NUMBER: Final = re.compile(
    rf"(?P<sign>[+-]?)[ \u00a0]?(?P<digits>[0-9][0-9{re.escape(_DECIMALS + _THOUSANDS)}]*)"
    r"(?P<exponent>[eE][+-]?[0-9]+)?(?P<behind>-?)"
)
_MAX_CHARACTERS: Final = 64


def decimal_separator(text: str) -> str | None:
    """A number's decimal separator; None if uncertain: a whole number, or 1,234, which may be 1234."""
    groups = re.split(f"([{re.escape(_DECIMALS + _THOUSANDS)}])", re.sub("[^0-9]+$", "", text))
    separators = groups[1::2]
    last = next((separator for separator in reversed(separators) if separator in _DECIMALS), None)
    if last is None or last not in _THOUSANDS:
        return last
    whole = re.sub("[^0-9]", "", groups[0])
    if any(other != last and other in _THOUSANDS for other in separators):
        return last
    if any(len(group) != 3 for group in groups[2::2]) or len(whole) > 3 or whole.startswith("0"):
        return last  # no groups of thousands
    if len(separators) == 1:
        return None
    return POINT if last != POINT else ","


def parse_number(text: str, decimal: str = POINT) -> float | None:
    """The number in `text`, perhaps infinite; None for other text. `decimal`: the decimal separator if `text`
    leaves it open."""
    if len(text) >= _MAX_CHARACTERS:
        return None
    match = _NUMBER.fullmatch(_INVISIBLE.sub("", text).replace("\u2212", "-").strip())
    if match is None or (match["sign"] and match["behind"]):
        return None
    decimal = decimal_separator(match["digits"]) or decimal
    digits = re.sub(f"[{re.escape(_THOUSANDS.replace(decimal, ''))}]", "", match["digits"]).replace(decimal, POINT)
    try:
        number = float(digits + (match["exponent"] or ""))
    except ValueError:  # two decimal separators, or one of another language
        return None
    return -number if "-" in (match["sign"], match["behind"]) else number


def format_number(value: float, decimal: str = POINT) -> str:
    """`value` with six decimals and this decimal separator."""
    return f"{value:.6f}".replace(POINT, decimal)
