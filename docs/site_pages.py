"""Brings the pages outside of docs/ into the site, turns links between files into links between pages, and shows
the code of examples.

A hook of MkDocs (mkdocs.yml); GitHub shows the same files where they are.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any, Final

from mkdocs.structure.files import File, Files

ROOT: Final = Path(__file__).resolve().parent.parent
PAGES: Final = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
}
_LINK: Final = re.compile(r"(?<=\]\()([^)#\s]+)")
_CODE: Final = re.compile(r"^\[(\S+)\]\(\.\./\1\)$", re.MULTILINE)
_LANGUAGES: Final = {".py": "python", ".proto": "proto", ".toml": "toml"}


def on_files(files: Files, config: Any) -> Files:
    for source, page in PAGES.items():
        content = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=content))
    return files


def with_code(markdown: str) -> str:
    """The text of a page, in which each line that is a link to a file of code alone becomes that code."""

    def shown(match: re.Match[str]) -> str:
        path = ROOT / match[1]
        return f"```{_LANGUAGES[path.suffix]}\n{path.read_text(encoding='utf-8')}```"

    return _CODE.sub(shown, markdown)


def on_page_markdown(markdown: str, page: Any, **_: object) -> str:
    sources = {site: source for source, site in PAGES.items()}
    folder = posixpath.dirname(sources.get(page.file.src_uri, f"docs/{page.file.src_uri}"))

    def linked(match: re.Match[str]) -> str:
        source = posixpath.normpath(posixpath.join(folder, match[1]))
        if not (ROOT / source).is_file():
            return match[1]
        target = PAGES.get(source, source.removeprefix("docs/"))
        return posixpath.relpath(target, posixpath.dirname(page.file.src_uri))

    return _LINK.sub(linked, with_code(markdown))
