"""Click options and parameter types that several commands share, except those of files."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Sequence
from datetime import tzinfo
from functools import partial, reduce
from importlib.util import find_spec
from math import inf, isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.cli.completion import complete_filter
from fte_sniff.errors import UsageError
from fte_sniff.platform import POSIX
from fte_sniff.protocol import DEFAULT_BAUD

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert, SilenceAlert
    from fte_sniff.analysis.line_setup import LineSetup
    from fte_sniff.cli.settings import Settings


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
                own.append((names, _RANGE.sub("", text)))
        for name, records in groups.items():
            with formatter.section(name):
                formatter.write_dl(records)


grouped_command = partial(click.command, cls=GroupedCommand)
"""As `click.command`, for a command with groups of options."""


alert_option = click.option(
    "--alert",
    "alert_text",
    metavar="EXPR",
    shell_complete=complete_filter,
    help="Ring the bell, at most once per second, when rows match: error != 0; or when a wire is "
    "silent for this many seconds: silence > 5.",
)
"""The `--alert` option; its value goes to `alert_of`."""


def alert_of(text: str | None, zone: tzinfo | None = None) -> Alert | SilenceAlert | None:
    """The alert of `--alert`, if it was given; raises FilterError if it is invalid.

    `zone` is that of times that name none; None for UTC.
    """
    if text is None:
        return None
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter, SilenceAlert

    if (seconds := silence_of(text)) is not None:
        return SilenceAlert(seconds)
    return Alert(RowFilter.parse(text, zone))


_SILENCE: Final = re.compile(r"\s*silence\s*>=?\s*(\d+(?:\.\d+)?)\s*", re.IGNORECASE)


def silence_of(text: str | None) -> float | None:
    """The seconds of `--alert 'silence > 5'`; None for another alert, or none."""
    found = _SILENCE.fullmatch(text or "")
    return float(found[1]) if found else None


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

list_format_option = format_option(
    "A table for people, or one JSON object per line.", ["table", "jsonl"], "table"
)


def require_pseudo_terminals(command: str, instead: str) -> None:
    """Raise UsageError, with another way, on a system without pseudo-terminals."""
    if not POSIX:
        raise UsageError(
            f"{command} needs pseudo-terminals, which Windows does not have: use it in WSL; "
            f"{instead}"
        )


def install_command(extra: str) -> str:
    """The command that adds the packages of an extra to this environment.

    It names the packages themselves: fte-sniff is on no package index, and an installation from its
    folder would compile the framer again.
    """
    import shlex
    from importlib.metadata import requires  # slow

    needs = [
        need.split(";")[0].strip() for need in requires("fte-sniff") or () if f'"{extra}"' in need
    ]
    packages = " ".join(map(shlex.quote, needs))
    prefix = Path(sys.prefix)
    if (prefix / "pipx_metadata.json").exists():
        return f"pipx inject {shlex.quote(prefix.name)} {packages}"
    python = shlex.quote(sys.executable)
    if find_spec("pip") is None:
        return f"uv pip install --python {python} {packages}"
    return f"{python} -m pip install {packages}"


DURATION_EXAMPLE: Final = "a time; use for example 100ms, 10s, 5min or 1h"
"""The end of the error for a text that is not a duration."""


def parse_seconds(text: str) -> float | None:
    """Seconds of `100ms`, `10s`, `5min`, `1h` or `2d`; infinity if they are too many for a float.

    None for other texts.
    """
    from fte_sniff.analysis.time_text import SECOND_NS, duration_ns

    found = duration_ns(text)
    try:
        return None if found is None else found / SECOND_NS
    except OverflowError:
        return inf


class Seconds(click.FloatRange):
    """A duration: seconds, or a number with a unit; infinity is allowed, NaN is not."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The seconds; fails for other texts and out of range."""
        parsed = parse_seconds(value) if isinstance(value, str) else None
        try:
            seconds = float(value if parsed is None else parsed)
        except ValueError:
            self.fail(f"{value!r} is not {DURATION_EXAMPLE}.", param, ctx)
        seconds = float(super().convert(seconds, param, ctx))
        if isnan(seconds):
            self.fail(f"{value!r} is not a number of seconds.", param, ctx)
        return seconds


class _Positive(click.FloatRange):
    """A finite number above 0."""

    name = "number"

    def __init__(self) -> None:
        super().__init__(min=0, min_open=True)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value!r} is not a number above 0.", param, ctx)
        return number


units_options = all_of(
    click.option(
        "--resolution",
        type=_Positive(),
        metavar="N",
        help="Pulses in one turn of a motor: shows positions in turns too.",
    ),
    click.option(
        "--gear-ratio",
        type=_Positive(),
        metavar="N",
        help="Turns of a motor in one turn of its output; 1 by default.",
    ),
)
"""The options `--resolution` and `--gear-ratio`, which show positions in turns too."""


def line_setup(
    settings: Settings,
    ports: Sequence[str],
    resolution: float | None,
    gear_ratio: float | None,
    baud: int = DEFAULT_BAUD,
) -> LineSetup:
    """The line setup from the options, with the settings of the ports as defaults.

    Raises UsageError if the settings of the ports differ, or a gear ratio has no resolution.
    """
    if resolution is None:
        resolution = settings.default(ports, "resolution")
    if resolution is not None and gear_ratio is None:
        gear_ratio = settings.default(ports, "gear-ratio")
    if resolution is None and gear_ratio is not None:
        raise UsageError("--gear-ratio makes turns of pulses only together with --resolution")
    from fte_sniff.analysis.line_setup import LineSetup

    return LineSetup(baud, resolution, 1.0 if gear_ratio is None else gear_ratio)
