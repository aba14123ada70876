"""The text of `--help`: the flags that most users need, on one screen. `--help-all` shows all flags.

A configuration lists its rare flags in `RARE: ClassVar[str]`. Parsing treats them as any other flag.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from types import UnionType
from typing import Annotated, Any, Final, NoReturn, Union, get_args, get_origin, get_type_hints

import tyro

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
