"""Click options and parameter types that several commands share, except those of files."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from copy import copy
from functools import partial, reduce
from inspect import cleandoc
from math import inf
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.cli.completion import complete_filter
from fte_sniff.errors import UsageError, quoted
from fte_sniff.i18n import translated
from fte_sniff.platform import POSIX

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert
    from fte_sniff.formats.writers import OutputFormat


Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def all_of(*options: Decorator) -> Decorator:
    """A decorator that gives a command these options, in this order."""
    return lambda command: reduce(lambda made, option: option(made), reversed(options), command)


def in_group(name: str, *options: Decorator) -> Decorator:
    """As `all_of`; the help of a `GroupedCommand` lists these options under a name."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        before = len(getattr(command, "__click_params__", ()))
        made = all_of(*options)(command)
        for option in made.__click_params__[before:]:  # type: ignore[attr-defined]
            option.group = name
        return made

    return decorate


_RANGE: Final = re.compile(r"; [^;\[\]]*\bx\b[^;\]]*(?=\])|  \[[^;\]]*\bx\b[^;\]]*\]")
"""The range of a number, which click adds to the help; an error names it."""
NUMBER: Final = re.compile(r"(INTEGER|FLOAT)( RANGE)?$")
"""The names of types that the help writes as N."""


class GroupedCommand(click.Command):
    """A command whose help lists its own options first, then those of each group."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, a section for each group."""
        groups: dict[str, list[tuple[str, str]]] = {"Options": []}
        for option in self.get_params(ctx):
            record = option.get_help_record(ctx) if isinstance(option, click.Option) else None
            if record is not None:
                names, text = record
                own = groups.setdefault(getattr(option, "group", "Options"), [])
                own.append((NUMBER.sub("N", names), _RANGE.sub("", text)))
        for name, records in groups.items():
            with formatter.section(translated(name)):
                formatter.write_dl(records)


def with_translated_help(command: click.Command) -> click.Command:
    """A command with the help of options, and its help in one line, in the language in use."""
    command = copy(command)
    command.params = [copy(option) for option in command.params]
    for option in command.params:
        if isinstance(option, click.Option):
            option.help = translated(option.help or "")
    short = command.short_help or ""
    if translated(short) != short:
        command.short_help = translated(short)
        command.help = f"{command.short_help}\n\n{cleandoc(command.help or '')}"
    return command


grouped_command = partial(click.command, cls=GroupedCommand)
"""As `click.command`, for a command with groups of options."""


def _alert(text: str) -> Alert:
    """The alert of `error != 0`, or of `silence > 5`; raises FilterError if it is invalid."""
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter

    found = _SILENCE.fullmatch(text)
    if found is None and text.strip().lower().startswith("silence"):
        raise UsageError("--alert: {text} lacks the seconds; write silence > 5", text=quoted(text))
    return Alert(None, float(found[1])) if found else Alert(RowFilter.parse(text))


_SILENCE: Final = re.compile(r"\s*silence\s*>=?\s*(\d+(?:\.\d+)?)\s*", re.IGNORECASE)

alert_option = click.option(
    "--alert",
    type=_alert,
    metavar="EXPR",
    shell_complete=complete_filter,
    help="Ring the bell, at most once per second, when rows match: error != 0; or when a wire is "
    "silent for this many seconds: silence > 5.",
)
"""The `--alert` option."""


def format_option(help_text: str, forms: Iterable[str], default: str | None = None) -> Decorator:
    """The `--format` option; its value is one of the forms, or None if not given and no default."""
    return click.option(
        "--format",
        "form",
        type=click.Choice(list(map(str, forms))),
        default=default,
        show_default=default is not None,
        help=help_text,
    )


rows_format_option = partial(
    format_option, "Format of the rows; a table has no colours if the output is not a terminal."
)
"""The `--format` option of a command whose rows may have some forms of `OutputFormat`."""


def _columns(_context: click.Context, _option: click.Parameter, text: str | None) -> Any:
    """The columns of a list with commas; raises UsageError if one is unknown."""
    if text is None:
        return None
    from fte_sniff.protocol.columns import COLUMN_BY_NAME

    names = dict.fromkeys(name.strip() for name in text.split(","))
    for name in names:
        if name not in COLUMN_BY_NAME:
            from fte_sniff.analysis.filter.row_filter import nearest

            fix = nearest(name, COLUMN_BY_NAME)
            raise UsageError(f"--columns: unknown column {quoted(name)}; {fix}")
    return tuple(names)


columns_option = click.option(
    "--columns",
    metavar="NAME,NAME",
    callback=_columns,
    help="Only these columns, in this order; CSV or JSON lines, by default CSV.",
)
"""The `--columns` option; `check_columns` refuses its value in other formats."""


def check_columns(columns: tuple[str, ...] | None, form: OutputFormat) -> None:
    """Raise UsageError if the columns of a format cannot be chosen."""
    from fte_sniff.formats.writers import CHOOSABLE

    if columns and form not in CHOOSABLE:
        raise UsageError(
            f"--columns chooses among those of csv and jsonl, and {form} has its own: leave"
            " --columns out, or use --format csv or jsonl"
        )


def require_pseudo_terminals(command: str, instead: str) -> None:
    """Raise UsageError, with another way, on a system without pseudo-terminals."""
    if not POSIX:
        raise UsageError(
            f"{command} needs pseudo-terminals, which Windows does not have: use it in WSL; "
            f"{instead}"
        )


def parse_seconds(text: str) -> float | None:
    """Seconds of `100ms`, `10s`, `5min`, `1h` or `2d`; None for other texts."""
    from fte_sniff.analysis.time_text import SECOND_NS, duration_ns

    found = duration_ns(text)
    return None if found is None else min(found, 1 << 100) / SECOND_NS  # not too much for a float


def seconds_from(low: float, high: float = inf) -> Callable[[str], float]:
    """The type of an option: seconds, or a number with a unit, from `low` to `high`."""

    def convert(text: str) -> float:
        found = parse_seconds(text) or parse_seconds(f"{text}s")
        if found is None or not low <= found <= high:
            most = "" if high == inf else f" to {high:g} s"
            raise click.BadParameter(
                f"{quoted(text)} is not a time from {low:g} s{most}; use for example 10s or 5min"
            )
        return found

    return convert
