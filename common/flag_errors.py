"""Errors in the command line, in one line: tyro's own texts are long, and name Python's types.

This uses a private hook of tyro. If a version of tyro has another hook or none, tyro prints its own text.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import sys
from collections.abc import Iterator, Sequence
from typing import Any, get_args, get_type_hints

import tyro

from common.errors import UsageError, did_you_mean


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
    subcommand = [name for name in _commands_of(config) if name in sys.argv[1:2]]
    command = dict.fromkeys([*event.prog.split(), *subcommand])
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
            return f"{_name_of(event.argument)}: expected {_expected(event.argument)} after it; {help_line}"
        case "InstantiationFailure" if event.argument is not None:
            is_positional = event.argument.is_positional()  # then it is an empty word, of a shell's unset variable
            name = "''" if is_positional else _name_of(event.argument)
            return f"{name}: expected {_expected(event.argument)}; {help_line}"
        case "InstantiationFailure":  # a config's own ValueError, which names the flag
            return str(event.message)
    raise AttributeError(type(event).__name__)


def _unknown(tokens: Sequence[str], config: Any) -> str:
    """The error about the first unknown flag, or else about the first unexpected word."""
    commands = _commands_of(config)
    if commands and tokens[0] == sys.argv[1] and not tokens[0].startswith("-"):
        meant = did_you_mean(tokens[0], commands)
        return f"{tokens[0]}: no such command; {meant or 'the commands are ' + ', '.join(commands)}"
    flag = next((token for token in tokens if token.startswith("-")), None)
    if flag is None:
        return f"{tokens[0]}: one word too many; put names with spaces in quotes, and words before all flags"
    flag = flag.partition("=")[0]
    if instead := getattr(config, "REMOVED", {}).get(flag):
        return f"{flag}: was removed; {instead}"
    names = [_name_on_command_line(field, notes) for field, notes in _flags_of(_of_command_line(config))]
    return f"{flag}: no such flag{did_you_mean('--' + flag.lstrip('-'), names, '; ')}"


def _commands_of(config: Any) -> list[str]:
    """The subcommands of a command; empty if it has none."""
    return [kind.__metadata__[0].name for kind in get_args(config)]


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
    if not dataclasses.is_dataclass(config):  # subcommands, and none of them on the command line
        return
    hints = get_type_hints(config, include_extras=True)
    for flag in dataclasses.fields(config):
        hint = hints[flag.name]
        inner = getattr(hint, "__origin__", hint)
        if dataclasses.is_dataclass(inner):
            yield from _flags_of(inner)
        else:
            yield flag, getattr(hint, "__metadata__", ())


def _name_on_command_line(flag: dataclasses.Field[Any], notes: Sequence[Any]) -> str:
    name = next((note.name for note in notes if getattr(note, "name", None)), flag.name)
    return ("--no-" if flag.default is True else "--") + name.replace("_", "-")


def _expected(argument: Any) -> str:
    metavar = str(argument.lowered.metavar)
    return {"INT": "a whole number", "FLOAT": "a number"}.get(metavar, metavar)


def _name_of(argument: Any) -> str:
    return str(argument.lowered.metavar if argument.is_positional() else argument.lowered.name_or_flags[-1])
