"""Errors in the command line, in one line: tyro's own texts are long, and name Python's types.

This uses a private hook of tyro. If a version of tyro has another hook or none, tyro prints its own text.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import sys
from collections.abc import Iterator, Sequence
from types import UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from common.errors import UsageError, did_you_mean

_NUMBERS: Final = {"INT": "whole number", "FLOAT": "number"}
_COUNTS: Final = {1: "a", 2: "two", 3: "three"}


@contextlib.contextmanager
def flag_errors_in_one_line(config: Any) -> Iterator[None]:
    """Raise UsageError where tyro would print an error about the flags of `config`."""
    try:
        from tyro import _errors
    except ImportError:
        yield
        return

    def hook(event: _errors.ParseErrorEvent) -> None:
        try:
            line = _line_of(event, config)
        except (AttributeError, NameError):  # another version of tyro has other events
            return
        raise UsageError(line)

    with _errors.on_parse_error(hook):
        yield


def _line_of(event: Any, config: Any) -> str:
    subcommands = {name for name in _names_of(config) if not name.startswith("-")}
    command = dict.fromkeys([*event.prog.split(), *subcommands.intersection(sys.argv[1:2])])
    help_line = f"`{' '.join(command)} --help-all` has all flags"
    match type(event).__name__:
        case "UnrecognizedArgs":
            return f"{_unknown(event.tokens, config)}; {help_line}"
        case "MissingArgs":
            if event.unrecognized_tokens and event.unrecognized_tokens[0].startswith("-"):
                return f"{_unknown(event.unrecognized_tokens, config)}; {help_line}"
            names = " and ".join(_name_of(missing.arg) for missing in event.missing_arguments)
            return f"{names} {'is' if len(event.missing_arguments) == 1 else 'are'} missing; {help_line}"
        case "MissingSubcommand":
            return f"which command? One of {', '.join(event.subcommand_spec.parser_from_name)}; {help_line}"
        case "InvalidChoice":
            choices = sorted(event.choices)
            meant = did_you_mean(event.value, choices, "; ")
            return f"{_name_of(event.argument)} {event.value}: expected one of {', '.join(choices)}{meant}"
        case "BadValue" if event.reason == "too_few_values":
            if event.argument.is_positional():
                return f"{_name_of(event.argument)} is missing; {help_line}"
            return f"{_name_of(event.argument)}: expected {_expected(event.argument)} after it; {help_line}"
        case "InstantiationFailure" if event.argument is not None:
            is_empty_word = event.argument.is_positional() and "" in sys.argv
            words = ["" if is_empty_word else _name_of(event.argument), *_words_after(event.argument)]
            shown = " ".join(word or "''" for word in words)
            return f"{shown}: expected {_expected(event.argument)}; {help_line}"
        case "InstantiationFailure":  # a config's own ValueError, which names the flag
            return str(event.message)
    raise AttributeError(type(event).__name__)


def _unknown(tokens: Sequence[str], config: Any) -> str:
    """The error about the first unknown flag, or else about the first unexpected word."""
    names = list(_names_of(config))
    subcommands = [name for name in names if not name.startswith("-")]
    if subcommands and tokens[0] == next(iter(sys.argv[1:]), None) and not tokens[0].startswith("-"):
        meant = did_you_mean(tokens[0], subcommands)
        return f"{tokens[0]}: no such command; {meant or 'the commands are ' + ', '.join(subcommands)}"
    flag = next((token for token in tokens if token.startswith("-")), None)
    if flag is None:
        return _too_many(tokens[0], _of_command_line(config))
    flag = flag.partition("=")[0]
    if instead := getattr(config, "REMOVED", {}).get(flag):
        return f"{flag}: was removed; {instead}"
    if flag in names:  # of another subcommand
        return f"{flag}: not a flag of this command"
    return f"{flag}: no such flag{did_you_mean('--' + flag.lstrip('-'), names, '; ')}"


def _too_many(word: str, config: Any) -> str:
    """The error about a word that belongs to no flag. tyro has read the words before it."""
    too_many = f"{word}: one word too many"
    before = sys.argv[1 : sys.argv.index(word)] if word in sys.argv[1:] else []
    flags = [place for place, token in enumerate(before) if token.startswith("--")]
    switch = next((token for token in sys.argv[1:] if token.endswith(f"={word}")), "")
    if switch and word not in sys.argv[1:]:
        return f"{switch}: {switch.partition('=')[0]} takes no value"
    if flags and dataclasses.is_dataclass(config):
        hints = get_type_hints(config, include_extras=True)
        after = f"{too_many} after {' '.join(before[flags[-1] :])}"
        if any(_takes_several_words(hint) for hint in hints.values()):
            return f"{after}; put words without a flag before all flags"
        if choices := list(_choices(hints.get(before[flags[-1]][2:].replace("-", "_")))):
            return f"{after}; {before[flags[-1]]} is {' or '.join(choices)}"
    return f"{too_many}; put a name with spaces in quotes"


def _of_command_line(config: Any) -> Any:
    """The dataclass of the command or, if it has subcommands, of that on the command line."""
    kinds = (kind for kind in get_args(config) if kind.__metadata__[0].name in sys.argv[1:2])
    return next((kind.__origin__ for kind in kinds), config)


def refuse_empty_flags(config: Any) -> None:
    """Raise UsageError for a flag `X [X ...]` without a word: tyro would take no value, which often means
    everything."""
    tokens = [token.replace("_", "-") for token in sys.argv[1:]]
    empty = {flag for flag, word in itertools.pairwise([*tokens, "--"]) if flag[:2] == word[:2] == "--"}
    if not empty:  # the usual case: types take a millisecond
        return
    for flag, notes in _flags_of(_of_command_line(config)):
        name = f"--{flag.name.replace('_', '-')}"
        metavar = next((note.metavar for note in notes if getattr(note, "metavar", None)), "at least one word")
        is_several = isinstance(flag.default, tuple) and tyro.conf.Positional not in notes
        needs_words = is_several and not metavar.startswith("[")
        if needs_words and name in empty:
            raise UsageError(f"{name}: expected {metavar} after it")


def _flags_of(config: Any) -> Iterator[tuple[dataclasses.Field[Any], tuple[Any, ...]]]:
    """The flags of a dataclass, and of the dataclasses in it, each with the notes of its type."""
    hints = get_type_hints(config, include_extras=True)
    for flag in dataclasses.fields(config):
        hint = hints[flag.name]
        inner = getattr(hint, "__origin__", hint)
        if dataclasses.is_dataclass(inner):
            yield from _flags_of(inner)
        else:
            yield flag, getattr(hint, "__metadata__", ())


def _choices(hint: Any) -> Iterator[str]:
    if get_origin(hint) is Literal:
        yield from map(str, get_args(hint))
    else:
        for part in get_args(hint):
            yield from _choices(part)


def _takes_several_words(hint: Any) -> bool:
    is_positional = tyro.conf.Positional in getattr(hint, "__metadata__", ())
    return is_positional and get_origin(get_args(hint)[0]) is tuple


def _names_of(kind: Any) -> Iterator[str]:
    """Yield all flags and subcommands of a command. `kind` is its dataclass, or the union of its subcommands'
    dataclasses."""
    if get_origin(kind) in (Union, UnionType):
        for variant in get_args(kind):
            yield from (note.name for note in variant.__metadata__)
            yield from _names_of(variant.__origin__)
        return
    for flag, notes in _flags_of(kind):
        if tyro.conf.Positional not in notes and tyro.conf.Suppress not in notes:
            name = next((note.name for note in notes if getattr(note, "name", None)), flag.name)
            dashes = "--no-" if flag.default is True else "--"
            yield dashes + name.replace("_", "-")


def _name_of(argument: Any) -> str:
    return str(argument.lowered.metavar if argument.is_positional() else argument.lowered.name_or_flags[-1])


def _words_after(argument: Any) -> list[str]:
    """The words after a flag on the command line, up to the next flag."""
    names = {name.replace("_", "-") for name in argument.lowered.name_or_flags}
    for at, token in enumerate(sys.argv[1:], start=2):
        flag, equals, value = token.partition("=")
        if flag.replace("_", "-") in names:
            if equals:
                return [value]
            words = sys.argv[at:]
            end = next((i for i, word in enumerate(words) if word.startswith("--")), len(words))
            return words[:end]
    return []


def _expected(argument: Any) -> str:
    """The values that a flag expects: "two whole numbers" for "INT INT"; other types as in `--help`."""
    metavar = str(argument.lowered.metavar)
    kinds = metavar.split()
    if kinds and kinds[0] in _NUMBERS and set(kinds) == {kinds[0]} and len(kinds) in _COUNTS:
        return f"{_COUNTS[len(kinds)]} {_NUMBERS[kinds[0]]}{'s' * (len(kinds) > 1)}"
    return metavar
