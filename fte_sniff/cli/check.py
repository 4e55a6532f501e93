"""`fte-sniff check`: a verdict about files, for acceptance tests and CI.

Rules come from files and options; verdicts are a table, JSON, or JUnit XML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, tzinfo
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import click

from fte_sniff.cli.input_files import STDIN, FileName, InputQuery, check_inputs, input_options
from fte_sniff.cli.measuring import ManyFiles, many_files_options, measure, print_json
from fte_sniff.cli.options import format_option, grouped_command
from fte_sniff.cli.settings import read_toml
from fte_sniff.errors import UsageError, printable, unreadable
from fte_sniff.formats.looks import LOOKS
from fte_sniff.protocol import Status, iso_time, spaced_hex
from fte_sniff.session.stats_json import MOTOR, finding_json

if TYPE_CHECKING:
    from rich.text import Text

    from fte_sniff.analysis.check import Rule, Verdict
    from fte_sniff.analysis.findings import Finding
    from fte_sniff.protocol.rows import Row
    from fte_sniff.session.inputs import InputReading


VERSION: Final = 1

FORMS: Final = ("table", "json", "junit")

_STATUS: Final = {"pass": Status.OK, "fail": Status.MALFORMED, "not covered": Status.SUSPECT}
_NUMBER: Final = ".6g"


@grouped_command(name="check", short_help="A verdict about files: pass, fail, or not covered.")
@input_options
@click.option("--rules", type=FileName(), help="Rules of a TOML file.")
@click.option(
    "--expect",
    "expectations",
    multiple=True,
    metavar="RULE",
    help='A rule, such as "count(malformed) == 0"; may be repeated.',
)
@format_option("A table for people, one JSON object, or JUnit XML.", FORMS, FORMS[0])
@click.option(
    "--baseline",
    type=FileName(),
    metavar="FILE",
    help='A recording, or a folder of them, that "changed() == 0" compares with.',
)
@many_files_options
def command(
    query: InputQuery,
    rules: Path | None,
    expectations: tuple[str, ...],
    form: str,
    baseline: Path | None,
    pair: bool,
    jobs: int | None,
    cluster: str | None,
) -> None:
    """Compare measures of recordings, raw bytes or hex text with numbers, all files together.

    The exit code is 0 if all rules pass, 1 if one fails or has nothing to measure, 2 if a rule is
    invalid, 4 if a file cannot be read.

    \b
    fte-sniff check samples/clean.mcap --expect "count(malformed) == 0"
    fte-sniff check logs/ --rules rules.toml --format junit
    """
    check_inputs(query.files)
    wanted = read_rules(rules, expectations)
    from fte_sniff.analysis import compare
    from fte_sniff.analysis.check import analysis_of, verdicts

    before = None
    if baseline is not None:
        before, of_baseline = measure(replace(query, files=(baseline,)), compare.ANALYSIS)
        if of_baseline.interrupted or of_baseline.reading.unreadable:
            of_baseline.finish()
    total, measured = measure(query, analysis_of(wanted), ManyFiles(pair, jobs, cluster))
    found = verdicts(total, wanted, before)
    print_verdicts(found, total[0]["extent"].row(0, named=True), form, measured.reading, query)
    measured.finish(refused=any(one.refuses for one in found))


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
        try:
            text = read_toml(path, "name a rules file")
        except OSError as error:
            raise unreadable(path, error) from error
        found += rules_of_toml(text, str(path))
    found += [rule_at(f"--expect {number}", one) for number, one in enumerate(expectations, 1)]
    return found


def print_verdicts(
    verdicts: Sequence[Verdict],
    extent: Mapping[str, Any],
    form: str,
    reading: InputReading,
    query: InputQuery,
) -> None:
    """Print the verdicts about files on standard output; `extent` is that of their rows."""
    if form == "json":
        print_json(_object(verdicts, extent, reading, query))
    elif form == "junit":
        click.echo(junit_xml(verdicts, reading, query))
    else:
        from fte_sniff.cli.measuring import print_lines

        print_lines(partial(verdict_lines, verdicts, query=query, zone=reading.source.zone))


def verdict_lines(
    verdicts: Sequence[Verdict], width: int | None, *, query: InputQuery, zone: tzinfo = UTC
) -> Iterator[Text]:
    """A line for each rule; below it the row or finding that violates it, or what the rule needs.

    The inputs of `query` have the rows. The lines of a row are longer than `width` if need be.
    """
    from rich.text import Text

    from fte_sniff.cli.measuring import TextTable

    table = TextTable(["rule", "measured", "expected", "verdict"])
    for one in verdicts:
        expected = f"{one.rule.operator} {one.rule.number:{_NUMBER}}"
        cells = [printable(one.rule.name), measured_text(one), expected, _word(one)]
        mark = f"{LOOKS[Status.MALFORMED if one.refuses else Status.OK].mark} "
        table.append(cells, LOOKS[_STATUS[one.result]].style, mark)
    head, *lines = table.lines(width)
    yield head
    for one, line in zip(verdicts, lines, strict=True):
        yield line
        if one.row is not None:
            yield Text(f"    first {_row_text(one, one.row, query, zone)}", overflow="ignore")
        if one.finding is not None:
            yield Text(f"    {printable(_finding_text(one.finding, zone))}", overflow="ignore")
        if command := _view_command(one, query):
            yield Text(f"    {printable(command)}", overflow="ignore")
        if one.change:
            yield Text(f"    {printable(one.change)}", overflow="ignore")
        if one.needs:
            yield Text(f"    needs {printable(one.needs)}", overflow="ignore")


def _word(verdict: Verdict) -> str:
    allowed = not verdict.refuses and verdict.result == "not covered"
    return f"{verdict.result} (allowed)" if allowed else str(verdict.result)


def measured_text(verdict: Verdict) -> str:
    """The measured value with its unit; a dash if the rule is not covered."""
    if verdict.value is None:
        return "no duration" if verdict.result == "fail" else "–"
    return f"{verdict.value:{_NUMBER}} {verdict.rule.unit}".strip()


def _row_text(verdict: Verdict, row: Row, query: InputQuery, zone: tzinfo) -> str:
    place = f"offset {row.offset} of {printable(row.port)}"
    found = f"at {place}" if row.t_ns is None else f"at {iso_time(row.t_ns, zone)}, {place}"
    if (motor := row.values.get(MOTOR)) is not None:
        found += f", {MOTOR} {motor}"
    found += f": {spaced_hex(row.raw)}"
    is_only = query.files in ((Path(verdict.file),), (STDIN,))
    return found if is_only or not verdict.file else f"in {printable(verdict.file)} {found}"


def _finding_text(one: Finding, zone: tzinfo) -> str:
    first, last = (iso_time(t_ns, zone)[:19] for t_ns in (one.first_ns, one.last_ns))
    return f"{one.about}, {first} to {last}: {one.text}"


def _view_command(verdict: Verdict, query: InputQuery) -> str:
    """The command that shows the row, or the finding, of a verdict.

    Empty without one, and for rows that cannot be read again.
    """
    row, files = verdict.row, query.files
    if not files or STDIN in files:
        return ""
    if (found := verdict.finding) is not None:
        return query.view_command(found.decided_ns, found.filter)
    if row is None:
        return ""
    path = Path(verdict.file)
    own = replace(query, files=(path,) if verdict.file and path.exists() else files)
    return own.view_command(None if row.t_ns is None else (row.t_ns, row.t_ns), verdict.filter)


def _object(
    verdicts: Sequence[Verdict],
    extent: Mapping[str, Any],
    reading: InputReading,
    query: InputQuery,
) -> dict[str, Any]:
    errors, ends = [str(error) for error in reading.unreadable], ("least t", "greatest t")
    first, last = (None if extent[one] is None else iso_time(extent[one]) for one in ends)
    return {
        "version": VERSION,
        "passed": not errors and not any(one.refuses for one in verdicts),
        "rows": extent["sum rows"],
        "first_time": first,
        "last_time": last,
        "errors": errors,
        "notes": reading.notes,
        "rules": [_rule(one, query) for one in verdicts],
    }


def _rule(verdict: Verdict, query: InputQuery) -> dict[str, Any]:
    rule, row, found = verdict.rule, verdict.row, verdict.finding
    return {
        "name": rule.name,
        "expect": rule.expect,
        "may_be_uncovered": rule.may_be_uncovered,
        "verdict": str(verdict.result),
        "measured": verdict.value,
        "unit": rule.unit or None,
        "operator": rule.operator,
        "number": rule.number,
        "needs": verdict.needs or None,
        "row": row and {**_row(verdict, row), "view": _view_command(verdict, query) or None},
        "finding": found and {**finding_json(found), "view": _view_command(verdict, query) or None},
        "change": verdict.change or None,
    }


def _row(verdict: Verdict, row: Row) -> dict[str, Any]:
    return {
        "time": None if row.t_ns is None else iso_time(row.t_ns),
        "file": verdict.file or None,
        "port": row.port,
        "offset": row.offset,
        MOTOR: row.values.get(MOTOR),
        "raw": row.raw.hex().upper(),
    }


def junit_xml(verdicts: Sequence[Verdict], reading: InputReading, query: InputQuery) -> str:
    """The verdicts as a JUnit test suite; a file that cannot be read is an error."""
    errors = [str(error) for error in reading.unreadable]
    root = ET.Element("testsuites")
    suite = ET.SubElement(root, "testsuite", name="fte-sniff check")
    for one in verdicts:
        case = ET.SubElement(
            suite, "testcase", classname="fte-sniff.check", name=_xml(one.rule.name)
        )
        if one.refuses:
            details = f"{one.rule.expect}: {one.result}, measured {measured_text(one)}"
            if one.row is not None:
                details += f"; first {_row_text(one, one.row, query, reading.source.zone)}"
            if one.finding is not None:
                details += f"; {_finding_text(one.finding, reading.source.zone)}"
            details += f"; {one.change}" * bool(one.change) + _needs(one)
            failure = ET.SubElement(case, "failure", type=str(one.result), message=_xml(details))
            failure.text = _xml(_view_command(one, query)) or None
        elif one.result == "not covered":
            ET.SubElement(case, "skipped", message=f"not covered{_needs(one)}")
    for error in errors:
        case = ET.SubElement(suite, "testcase", classname="fte-sniff", name=_xml(error))
        ET.SubElement(case, "error", type="file", message=_xml(error))
    if reading.notes:
        ET.SubElement(suite, "system-err").text = "\n".join(map(_xml, reading.notes))
    suite.set("tests", str(len(verdicts) + len(errors)))
    suite.set("failures", str(sum(one.refuses for one in verdicts)))
    suite.set("errors", str(len(errors)))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True)


def _needs(verdict: Verdict) -> str:
    return f"; needs {verdict.needs}" if verdict.needs else ""


def _xml(text: str) -> str:
    """The text without characters that XML has no way to write."""
    return printable(text).encode(errors="replace").decode()
