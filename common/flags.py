"""Flags: `--help` on one screen, and errors in one line. tyro's own are long, and name Python's types.

`--help` shows the flags that most users need, `--help-all` shows all. A configuration lists its rare flags in
`RARE: ClassVar[str]`; parsing treats them as any other flag. Types are checked without typeguard, which takes
50 ms to load.

This uses private hooks of tyro. If a version of tyro has other hooks or none, tyro does as it does by itself.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import sys
from collections.abc import Iterable, Iterator, Sequence
from types import UnionType
from typing import Annotated, Any, Final, NoReturn, Union, get_args, get_origin, get_type_hints

import tyro

from common.errors import UsageError, did_you_mean

_HELP_ALL: Final = "--help-all"


def asks_for_help(words: Sequence[str]) -> bool:
    return not {"-h", "--help", _HELP_ALL}.isdisjoint(words)


def print_help(prog: str, config: Any, about: str, words: Sequence[str], default: Any | None) -> NoReturn:
    """Print the help that the command line `words` requests. `default` holds the shown default values."""
    shown = shown_by_help(config, with_rare=_HELP_ALL in words)
    defaults = {} if default is None else {"default": _converted(default, shown)}
    about += f" {_HELP_ALL} shows all flags." if _has_rare_flags(config) else ""
    subcommand = [] if dataclasses.is_dataclass(config) or words[0].startswith("-") else [words[0]]
    pairs_off = (tyro.conf.FlagCreatePairsOff,)
    tyro.cli(shown, prog=prog, description=about, config=pairs_off, args=[*subcommand, "--help"], **defaults)
    raise SystemExit(0)  # never reached: tyro raises SystemExit after the help


def shown_by_help(config: Any, with_rare: bool) -> Any:
    """A variant of a configuration for the text of `--help`, without rare flags and empty defaults.

    `config` is a dataclass, or the union of the subcommands' dataclasses.
    """
    if get_origin(config) in (Union, UnionType):
        kinds = [(variant.__origin__, variant.__metadata__) for variant in get_args(config)]
        return Union[tuple(Annotated[(shown_by_help(kind, with_rare), *notes)] for kind, notes in kinds)]  # noqa: UP007
    hints = get_type_hints(config, include_extras=True)
    hidden = [] if with_rare else _rare(config)
    changed = []
    for flag in dataclasses.fields(config):
        hint = hints[flag.name]
        notes = getattr(hint, "__metadata__", ())
        kind = hint.__origin__ if notes else hint
        default, factory = flag.default, flag.default_factory
        if flag.name in hidden:
            hint = Annotated[(hint, tyro.conf.Suppress)]
        elif dataclasses.is_dataclass(kind):
            factory = shown_by_help(kind, with_rare)
            hint = Annotated[(factory, *notes)]
        else:
            has_text = any(getattr(note, "help_behavior_hint", None) for note in notes)
            is_off = default in (None, (), "") or isinstance(default, bool)
            if is_off and not has_text and tyro.conf.UseAppendAction not in notes:
                hint = Annotated[hint, tyro.conf.arg(help_behavior_hint="")]
            if default is factory is dataclasses.MISSING and get_origin(kind) is tuple:
                hint = Annotated[hint, tyro.conf.arg(help_behavior_hint="(required)")]  # tyro writes "(default: )"
        if hint is not hints[flag.name]:
            values = {"default": default, "default_factory": factory}
            arguments: dict[str, Any] = {
                name: value for name, value in values.items() if value is not dataclasses.MISSING
            }
            changed.append((flag.name, hint, dataclasses.field(**arguments)))
    shown = dataclasses.make_dataclass(config.__name__, changed, bases=(config,), frozen=True)
    shown.__doc__ = config.__doc__
    return shown


def _rare(config: Any) -> list[str]:
    return getattr(config, "RARE", "").split()


def _has_rare_flags(config: Any) -> bool:
    if not dataclasses.is_dataclass(config):
        return False
    hints = get_type_hints(config)
    return bool(_rare(config)) or any(_has_rare_flags(hints[flag.name]) for flag in dataclasses.fields(config))


def _converted(values: Any, kind: Any) -> Any:
    """`values` as an instance of `kind`, a variant of its class."""
    hints = get_type_hints(kind)
    fields = {flag.name: getattr(values, flag.name) for flag in dataclasses.fields(kind)}
    converted = {
        name: _converted(value, hints[name]) for name, value in fields.items() if dataclasses.is_dataclass(value)
    }
    return kind(**fields | converted)


@contextlib.contextmanager
def quick_types() -> Iterator[None]:
    """Replace tyro's type check in the block, for flags without a default, and for unions and tuples of simple
    types; and its names of unions."""
    try:
        from tyro import _resolver, _strings
        from tyro._resolver import is_instance
        from tyro._singleton import is_sentinel
        from tyro._strings import join_union_metavars
    except ImportError:
        yield
        return

    def has_type(typ: Any, value: Any) -> bool:
        if is_sentinel(value):
            return False
        if isinstance(typ, UnionType):
            return any(has_type(member, value) for member in get_args(typ))
        if get_origin(typ) is tuple and not isinstance(value, tuple):
            return False
        if get_origin(typ) is tuple and get_args(typ)[1:] == (Ellipsis,):
            return all(has_type(get_args(typ)[0], item) for item in value)
        return is_instance(typ, value)

    def name_of_union(metavars: Iterable[str]) -> str:
        shown = [name for name in metavars if name != "{None}"]
        return join_union_metavars(shown) if len(shown) > 1 else shown[0]

    _resolver.is_instance, _strings.join_union_metavars = has_type, name_of_union
    try:
        yield
    finally:
        _resolver.is_instance, _strings.join_union_metavars = is_instance, join_union_metavars


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
