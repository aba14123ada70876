"""Blocks of Markdown pages that scripts write, between `<!-- generated: NAME -->` and `<!-- end -->`."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
_BLOCK: Final = re.compile(r"(<!-- generated: (.+?) -->\n).*?(<!-- end -->\n)", re.DOTALL)


def with_blocks(page: str, blocks: Mapping[str, str]) -> str:
    """The text of a page with each of its generated blocks replaced; all blocks must be there, and no others."""
    names = [match[2] for match in _BLOCK.finditer(page)]
    if sorted(names) != sorted(blocks):
        sys.exit(f"generated blocks of the page: {sorted(names)}; expected {sorted(blocks)}")
    return _BLOCK.sub(lambda match: f"{match[1]}\n{blocks[match[2]]}\n{match[3]}", page)


def update(path: Path, page: str) -> None:
    """Write a page if its text has changed."""
    if path.read_text(encoding="utf-8") != page:
        path.write_text(page, encoding="utf-8")
        print(path.relative_to(ROOT))
