"""`fte-sniff check`: a verdict about files, for acceptance tests and CI.

Rules come from files and options; verdicts are a table, JSON, or JUnit XML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import tzinfo
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import click

from fte_sniff.analysis.table import MOTOR
from fte_sniff.cli.input_files import STDIN, FileName, InputQuery, input_options
from fte_sniff.cli.measuring import finish, headline, measure, print_json, print_lines, table_lines
from fte_sniff.cli.options import format_option, grouped_command
from fte_sniff.cli.settings import read_toml
from fte_sniff.errors import UsageError, printable
from fte_sniff.formats.looks import LOOKS
from fte_sniff.protocol.columns import iso_time, spaced_hex
from fte_sniff.protocol.spec import Status
from fte_sniff.session.stats_json import fields_json, finding_json, time_json

if TYPE_CHECKING:
    from rich.text import Text

    from fte_sniff.analysis.check import Rule, Verdict
    from fte_sniff.protocol.rows import Row
    from fte_sniff.session.inputs import InputReading


VERSION: Final = 1

_STATUS: Final = {"pass": Status.OK, "fail": Status.MALFORMED, "not covered": Status.SUSPECT}
_NUMBER: Final = ".6g"


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
@format_option(
    "A table for people, one JSON object, or JUnit XML.", ("table", "json", "junit"), "table"
)
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
    fte-sniff check logs/ --rules rules.toml --format junit
    """
    wanted = read_rules(rules, expectations)
    from fte_sniff.analysis import compare
    from fte_sniff.analysis.check import analysis_of, verdicts

    before = None
    if baseline is not None:
        before, of_baseline = measure(replace(query, files=(baseline,)), compare.ANALYSIS)
        if of_baseline.unreadable:
            finish(of_baseline)
    total, reading = measure(query, analysis_of(wanted))
    found = verdicts(total, wanted, before)
    if form == "json":
        print_json(_object(found, total[0]["extent"].row(0, named=True), reading, query))
    elif form == "junit":
        click.echo(_junit_xml(found, reading, query))
    else:
        print_lines(_lines(found, query, reading.source.zone))
    finish(reading, refused=any(one.refuses for one in found))


def read_rules(path: Path | None, expectations: tuple[str, ...] = ()) -> list[Rule]:
    """The rules of a file and of options.

    Raises:
        FileError: the file cannot be read.
        InputTextError: a rule is invalid.
        UsageError: no rule is given.
    """
    from fte_sniff.analysis.check import rule_at, rules_of_toml

    if path is None and not expectations:
        raise UsageError('check needs rules: --rules FILE, or --expect "count(malformed) == 0"')
    found: list[Rule] = []
    if path is not None:
        found += rules_of_toml(read_toml(path), str(path))
    found += [rule_at(f"--expect {number}", one) for number, one in enumerate(expectations, 1)]
    return found


def _lines(verdicts: Sequence[Verdict], query: InputQuery, zone: tzinfo) -> Iterator[Text]:
    """A line for each rule, and its details below it."""
    from rich.text import Text

    rows = []
    for one in verdicts:
        mark = LOOKS[Status.MALFORMED if one.refuses else Status.OK].mark
        expected = f"{one.rule.operator} {one.rule.number:{_NUMBER}}"
        allowed = " (allowed)" * (one.result == "not covered" and not one.refuses)
        name = f"{mark} {printable(one.rule.name)}"
        rows.append([name, _measured(one), expected, f"{one.result}{allowed}"])
    styles = [LOOKS[_STATUS[one.result]].style for one in verdicts]
    head, *lines = table_lines(["  rule", "measured", "expected", "verdict"], rows, styles)
    yield head
    for one, line in zip(verdicts, lines, strict=True):
        yield line
        yield from (Text(f"    {text}") for text in _details(one, query, zone))


def _measured(verdict: Verdict) -> str:
    """The measured value with its unit; a dash if the rule is not covered."""
    if verdict.value is None:
        return "no duration" if verdict.result == "fail" else "–"
    return f"{verdict.value:{_NUMBER}} {verdict.rule.unit}".strip()


def _details(verdict: Verdict, query: InputQuery, zone: tzinfo) -> list[str]:
    """The row or finding that violates a rule, the command that shows it, or what a rule needs."""
    texts = [
        verdict.row and f"first {_row_text(verdict, verdict.row, query, zone)}",
        verdict.finding and f"{headline(verdict.finding, (), zone)}: {verdict.finding.text}",
        verdict.text,
        _view_command(verdict, query),
        verdict.needs and f"needs {verdict.needs}",
    ]
    return [printable(text) for text in texts if text]


def _row_text(verdict: Verdict, row: Row, query: InputQuery, zone: tzinfo) -> str:
    place = f"offset {row.offset} of {row.port}"
    found = f"at {place}" if row.t_ns is None else f"at {iso_time(row.t_ns, zone)}, {place}"
    if (motor := row.values.get(MOTOR)) is not None:
        found += f", {MOTOR} {motor}"
    found += f": {spaced_hex(row.raw)}"
    is_only = query.files in ((Path(verdict.file),), (STDIN,))
    return found if is_only or not verdict.file else f"in {verdict.file} {found}"


def _view_command(verdict: Verdict, query: InputQuery) -> str:
    """The command that shows the row, or the finding, of a verdict.

    Empty without one, and for rows that cannot be read again.
    """
    row, found, path = verdict.row, verdict.finding, Path(verdict.file)
    if STDIN in query.files or not (row or found):
        return ""
    if verdict.file and path.exists():
        query = replace(query, files=(path,))
    if found:
        return query.view_command(found.decided_ns, found.filter)
    if row is None or row.t_ns is None:
        return query.view_command(None, verdict.filter)
    gap_s = (verdict.value or 0) if verdict.rule.measure == "max_gap" else 0
    return query.view_command((row.t_ns, row.t_ns + round(gap_s * 1e9)), verdict.filter)


def _object(
    verdicts: Sequence[Verdict],
    extent: Mapping[str, Any],
    reading: InputReading,
    query: InputQuery,
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
        "rules": [_rule(one, query) for one in verdicts],
    }


def _rule(verdict: Verdict, query: InputQuery) -> dict[str, Any]:
    rule, row, found = verdict.rule, verdict.row, verdict.finding
    view = {"view": _view_command(verdict, query) or None}
    return {
        **fields_json(rule, "name", "expect", "may_be_uncovered", "operator", "number"),
        "unit": rule.unit or None,
        "verdict": str(verdict.result),
        "measured": verdict.value,
        "needs": verdict.needs or None,
        "row": row and _row(verdict.file, row) | view,
        "finding": found and finding_json(found) | view,
        "change": (rule.measure == "changed" and verdict.text) or None,
        "text": verdict.text or None,
    }


def _row(file: str, row: Row) -> dict[str, Any]:
    return {
        **fields_json(row, "port", "offset"),
        "time": time_json(row.t_ns),
        "file": file or None,
        MOTOR: row.values.get(MOTOR),
        "raw": row.raw.hex().upper(),
    }


def _junit_xml(verdicts: Sequence[Verdict], reading: InputReading, query: InputQuery) -> str:
    """The verdicts as a JUnit test suite; a file that cannot be read is an error."""
    root = ET.Element("testsuites")
    suite = ET.SubElement(root, "testsuite", name="fte-sniff check")
    for one in verdicts:
        name = _xml(one.rule.name)
        case = ET.SubElement(suite, "testcase", classname="fte-sniff.check", name=name)
        if one.result != "pass":
            message = _xml(f"{one.rule.expect}: {one.result}, measured {_measured(one)}")
            tag = "failure" if one.refuses else "skipped"
            found = ET.SubElement(case, tag, type=str(one.result), message=message)
            found.text = "\n".join(map(_xml, _details(one, query, reading.source.zone))) or None
    for error in map(_xml, map(str, reading.unreadable)):
        case = ET.SubElement(suite, "testcase", classname="fte-sniff", name=error)
        ET.SubElement(case, "error", type="file", message=error)
    if reading.notes:
        ET.SubElement(suite, "system-err").text = "\n".join(map(_xml, reading.notes))
    errors = len(reading.unreadable)
    suite.set("tests", str(len(verdicts) + errors))
    suite.set("failures", str(sum(one.refuses for one in verdicts)))
    suite.set("errors", str(errors))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True)


def _xml(text: str) -> str:
    """The text without characters that XML has no way to write."""
    return printable(text).encode(errors="replace").decode()
