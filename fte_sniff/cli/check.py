"""`fte-sniff check`: a verdict about files, for acceptance tests and CI.

Rules come from files and options; verdicts are a table, or JSON.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import tzinfo
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.analysis.table import MOTOR
from fte_sniff.cli.input_files import FileName, InputQuery, input_options
from fte_sniff.cli.measuring import (
    finish,
    measure,
    print_json,
    print_lines,
    table_lines,
    text_or_json_option,
)
from fte_sniff.cli.options import grouped_command
from fte_sniff.cli.settings import read_toml
from fte_sniff.errors import UsageError, printable
from fte_sniff.formats.cell_text import UNKNOWN
from fte_sniff.formats.looks import LOOKS
from fte_sniff.i18n import _
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.spec import Status
from fte_sniff.session.stats_json import fields_json, time_json

if TYPE_CHECKING:
    from rich.text import Text

    from fte_sniff.analysis.check import Rule, Verdict
    from fte_sniff.session.inputs import InputReading


VERSION: Final = 1

NUMBER: Final = ".6g"


@grouped_command(name="check", short_help="A verdict about files: pass, fail, or not covered.")
@input_options(many=True)
@click.option("--rules", type=FileName(), help="Rules of a TOML file.")
@click.option(
    "--expect",
    "expectations",
    multiple=True,
    metavar="RULE",
    help='A rule, such as "count(malformed) == 0"; may be repeated.',
)
@text_or_json_option
@click.option(
    "--baseline",
    type=FileName(),
    metavar="FILE",
    help='A recording, or a folder of them, that "changed() == 0" compares with.',
)
def command(
    query: InputQuery,
    rules: Path | None,
    expectations: tuple[str, ...],
    form: str,
    baseline: Path | None,
) -> None:
    """Compare measures of recordings, raw bytes or hex text with numbers, all files together.

    The exit code is 0 if all rules pass, 1 if one fails or has nothing to measure, 2 if a rule is
    invalid, 4 if a file cannot be read.

    \b
    fte-sniff check samples/clean.mcap --expect "count(malformed) == 0"
    fte-sniff check logs/ --rules rules.toml --format json
    """
    wanted = read_rules(rules, expectations)
    from fte_sniff.analysis import compare
    from fte_sniff.analysis.check import analysis_of, verdict

    before = None
    if baseline is not None:
        before, of_baseline = measure(replace(query, files=(baseline,)), compare.ANALYSIS)
        if of_baseline.unreadable:
            finish(of_baseline)
    total, reading = measure(query, analysis_of(wanted))
    found = [verdict(rule, total, before) for rule in wanted]
    if form == "json":
        print_json(_object(found, total["extent"].row(0, named=True), reading))
    else:
        print_lines(_lines(found, reading.zone))
    finish(reading, refused=any(one.refuses for one in found))


def read_rules(path: Path | None, expectations: tuple[str, ...] = ()) -> list[Rule]:
    """The rules of a file and of options.

    Raises:
        FileError: the file cannot be read.
        InputTextError: a rule is invalid.
        UsageError: no rule is given.
    """
    from fte_sniff.analysis.check import parse_rule, rules_of_toml

    if path is None and not expectations:
        raise UsageError('check needs rules: --rules FILE, or --expect "count(malformed) == 0"')
    found: list[Rule] = []
    if path is not None:
        found += rules_of_toml(read_toml(path), str(path))
    return found + [parse_rule(one) for one in expectations]


def _lines(verdicts: Sequence[Verdict], zone: tzinfo) -> Iterator[Text]:
    """A line for each rule, and its details below it."""
    from rich.text import Text

    rows = []
    for one in verdicts:
        mark = LOOKS[Status.MALFORMED if one.refuses else Status.OK].mark
        value, unit = one.value, one.rule.unit
        measured = UNKNOWN if value is None else _(f"{{value:{NUMBER}}} {unit}", value=value)
        expected = f"{one.rule.operator} {one.rule.number:{NUMBER}}"
        is_allowed = one.result == "not covered" and not one.refuses
        result = _("not covered (allowed)") if is_allowed else _(one.result)
        name = f"{mark} {printable(one.rule.name)}"
        rows.append([name, measured.strip(), expected, result])
    heads = [f"  {_('rule')}", _("measured"), _("expected"), _("verdict")]
    head, *lines = table_lines(heads, rows)
    yield head
    for one, line in zip(verdicts, lines, strict=True):
        yield line
        row = one.row and _("first row: {row}", row=_row_text(one.row, zone))
        for text in (row, one.needs and _("needs {needs}", needs=_(one.needs)), _(one.text)):
            if text:
                yield Text(f"    {printable(text)}")


def _row_text(row: Mapping[str, Any], zone: tzinfo) -> str:
    """`a.mcap, 2026-01-31T12:00:30Z, /dev/ttyUSB0, offset 20, motor 3: AA01...`."""
    time = "" if row["time"] is None else f", {iso_time(row['time'], zone)}"
    place = f"{row['file']}{time}, {row['port']}, offset {row['offset']}"
    motor = "" if row[MOTOR] is None else f", {MOTOR} {row[MOTOR]}"
    return f"{place}{motor}: {row['raw']}"


def _object(
    verdicts: Sequence[Verdict], extent: Mapping[str, Any], reading: InputReading
) -> dict[str, Any]:
    errors = [str(error) for error in reading.unreadable]
    return {
        "version": VERSION,
        "passed": not errors and not any(one.refuses for one in verdicts),
        "rows": extent["sum rows"],
        "first_time": time_json(extent["least t"]),
        "last_time": time_json(extent["greatest t"]),
        "errors": errors,
        "notes": reading.notes,
        "rules": [_rule(one) for one in verdicts],
    }


def _rule(verdict: Verdict) -> dict[str, Any]:
    rule, row = verdict.rule, verdict.row
    return {
        **fields_json(rule, "name", "expect", "may_be_uncovered", "operator", "number"),
        "unit": rule.unit or None,
        "verdict": str(verdict.result),
        "measured": verdict.value,
        "needs": verdict.needs or None,
        "row": row and {**row, "time": time_json(row["time"])},
        "text": verdict.text or None,
    }
