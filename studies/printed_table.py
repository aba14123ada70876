"""Tables of Markdown that the studies print, row by row."""

from __future__ import annotations


def print_head(*columns: object) -> None:
    print_row(*columns)
    print("|" + "---|" * len(columns))


def print_row(*cells: object) -> None:
    """Print a row. None is a value that is not known yet."""
    print(f"| {' | '.join('-' if cell is None else str(cell) for cell in cells)} |", flush=True)
