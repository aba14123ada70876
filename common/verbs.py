"""Commands with verbs, such as `bc-record me`: the first word chooses the flags and the action.

Flags of version 0.3 that have become verbs are understood for one version more.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from common.command import run_command
from common.errors import UsageError
from common.flags import asks_for_help
from common.output import print_message


class Verb(NamedTuple):
    """The dataclass of a verb's flags, and its action, which returns the exit code."""

    config: type[Any]
    action: Callable[[Any], int]
    default: Callable[[], Any | None] | None = None


class Earlier(NamedTuple):
    """A flag of version 0.3 that chose what is now a verb."""

    flag: str
    verb: str
    value: str = ""  # only with this value
    moved: int = 0  # the first values of the flag, which now follow the verb
    renamed: Mapping[str, str] = {}  # the flag's name now, by verb; else it is left out


def word_after_verb(name: str) -> str | None:
    """The first word after the verb, from which the defaults of its flags follow; None if the verb stands alone.

    Raises UsageError for a flag before it.
    """
    words = sys.argv[1:]
    if not words or (words[0].startswith("-") and asks_for_help(words)):
        return None
    if words[0].startswith("-"):
        raise UsageError(f"{words[0]}: {name} comes first, then the flags")
    return words[0]


def run_verbs(prog: str, plain: Verb, verbs: Mapping[str, Verb], earlier: Sequence[Earlier] = ()) -> None:
    """Run the command line of this process; `plain` if its first word is no verb."""
    words = sys.argv[1:]
    if words[:1] and words[0] not in verbs:
        words = in_verbs(words, earlier)
        if words != sys.argv[1:]:
            print_message(f"this is now `{prog} {shlex.join(words)}`", heading=f"{prog}:")
    chosen = plain
    if words[:1] and words[0] in verbs:
        verb, *words = words
        prog, chosen = f"{prog} {verb}", verbs[verb]
    sys.argv[1:] = words
    run_command(prog, chosen.config, chosen.action, default=chosen.default)


def in_verbs(words: Sequence[str], earlier: Sequence[Earlier]) -> list[str]:
    """A command line of version 0.3 as it is typed now."""
    rest = [part for word in words for part in (word.split("=", 1) if word.startswith("--") else [word])]
    verb: list[str] = []
    for old in earlier:
        at = rest.index(old.flag) if old.flag in rest else len(rest)
        if at == len(rest) or (old.value and rest[at + 1 : at + 2] != [old.value]):
            continue
        verb = verb or [old.verb]
        renamed = old.renamed.get(verb[0])
        end = at + 1 + bool(old.value) + old.moved
        verb += rest[at + 1 + bool(old.value) : end]
        rest[at:end] = [renamed] if renamed else []
    return [*verb, *rest] if verb else list(words)
