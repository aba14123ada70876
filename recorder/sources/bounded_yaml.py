"""YAML that somebody else may have written: mappings, lists and texts, in bounded number and depth.

ruamel's loaders take seconds for 40 KB of brackets, and never end with a kilobyte of mappings that are merged into
one another. Its parser gives one event after the other, and repeats nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from typing import Any, Final

MAX_EVENTS: Final = 50_000
MAX_DEPTH: Final = 20


def yaml_content(text: bytes) -> Any:
    """The first document, in which what is no mapping and no list is text; None in the place of a repetition.
    Raises ImportError without ruamel.yaml, and any other exception for what is no YAML, or more or deeper."""
    from ruamel.yaml import YAML
    from ruamel.yaml.events import (
        CollectionEndEvent,
        DocumentStartEvent,
        MappingStartEvent,
        ScalarEvent,
        SequenceStartEvent,
    )

    def bounded() -> Iterator[Any]:
        for number, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
            if number == MAX_EVENTS:
                raise ValueError(f"more than {MAX_EVENTS:,} events")
            yield event

    events = bounded()

    def value(event: Any, depth: int = 0) -> Any:
        if depth > MAX_DEPTH:
            raise ValueError(f"deeper than {MAX_DEPTH} levels")
        before_end = takewhile(lambda each: not isinstance(each, CollectionEndEvent), events)
        inner = (value(each, depth + 1) for each in before_end)
        if isinstance(event, SequenceStartEvent):
            return list(inner)
        if isinstance(event, MappingStartEvent):
            return {key: content for key, content in zip(inner, inner, strict=True) if isinstance(key, str)}
        return event.value if isinstance(event, ScalarEvent) else None

    for event in events:
        if isinstance(event, DocumentStartEvent):
            return value(next(events))
    return None
