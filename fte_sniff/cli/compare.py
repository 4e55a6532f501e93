"""`fte-sniff compare`: what changed between two recordings, best first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from rich.text import Text

from fte_sniff.cli.input_files import STDIN, InputQuery, input_options
from fte_sniff.cli.measuring import (
    finish,
    measure,
    print_json,
    print_lines,
    table_lines,
    text_or_json_option,
)
from fte_sniff.cli.options import grouped_command
from fte_sniff.errors import UsageError, printable
from fte_sniff.formats.cell_text import UNKNOWN, rate_text, share_text, span_text
from fte_sniff.formats.looks import LOOKS
from fte_sniff.i18n import _
from fte_sniff.protocol.spec import Status
from fte_sniff.session.stats_json import comparison_json

if TYPE_CHECKING:
    from fte_sniff.analysis.compare import Comparison, Number


@grouped_command(name="compare", short_help="What changed between two recordings, best first.")
@input_options(filters=False)
@text_or_json_option
def command(query: InputQuery, form: str) -> None:
    """Compare two recordings, BEFORE and AFTER: two days, two firmwares, two robots.

    Rates and periods, answer times, unanswered commands, damage, flags, ranges of values, silences
    and findings; what changed by more than chance is named, the largest change first. Each side is
    a file, a folder of recordings, or a pattern such as 'monday/*.mcap'.

    \b
    fte-sniff compare samples/clean.mcap samples/motor3.mcap
    fte-sniff compare monday/ tuesday/ --format json
    """
    from fte_sniff.analysis.compare import ANALYSIS, compared

    if len(query.files) != 2 or STDIN in query.files:
        raise UsageError(
            "compare needs two sides, BEFORE and AFTER; several files of a side are a folder, or a"
            " pattern in quotes, as in 'monday/*.mcap'"
        )
    sides = [measure(replace(query, files=(file,)), ANALYSIS) for file in query.files]
    (before, _before), (after, _after) = sides
    found = compared(before, after)
    if form == "json":
        print_json(comparison_json(found, before, after))
    else:
        print_lines(comparison_lines(found))
    finish(*(reading for __, reading in sides))


_ALWAYS: Final = ("period", "delay", "delay_p99", "unanswered", "damage")
"""Measures whose numbers are shown whether or not they changed."""


def comparison_lines(found: Comparison) -> Iterator[Text]:
    """What changed, the numbers of both sides with marks, and what was not compared."""
    for number, change in enumerate(found.changes, 1):
        yield Text(f"{number}. {printable(_(change.text))}")
    if not found.changes and found.numbers:
        yield Text(_("no change that is more than chance and large enough to matter"))
    shown = [one for one in found.numbers if one.score or one.measure in _ALWAYS]
    if shown:
        rows = [[_name(one), _value(one, one.before), _value(one, one.after)] for one in shown]
        yield Text()
        yield from table_lines([f"  {_('measure')}", _("before"), _("after")], rows)
    if found.not_compared:
        yield Text()
    for text in found.not_compared:
        yield Text(printable(_("not compared: {text}", text=text)))


def _name(one: Number) -> str:
    mark = LOOKS[Status.SUSPECT if one.score else Status.OK].mark
    names = (mark, one.measure, one.kind, one.motor)
    return printable(" ".join(str(part) for part in names if part is not None))


def _value(one: Number, value: float | None) -> str:
    if value is None:
        return UNKNOWN
    if one.measure in ("values", "findings"):
        return f"{value:g}"
    if one.measure == "rate":
        return rate_text(value)
    if one.measure in ("unanswered", "damage", "error_flag", "offline", "silence"):
        return share_text(value)
    return span_text(value * 1e9)
