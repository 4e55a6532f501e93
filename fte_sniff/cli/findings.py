"""`fte-sniff findings`: the spans of time in which something is wrong, best first."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import tzinfo
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.input_files import STDIN, InputQuery, check_inputs, input_options
from fte_sniff.cli.measuring import (
    ManyFiles,
    many_files_options,
    measure,
    print_json,
    text_or_json_option,
)
from fte_sniff.cli.options import grouped_command
from fte_sniff.cli.settings import load_settings
from fte_sniff.errors import printable
from fte_sniff.i18n import _, set_language
from fte_sniff.protocol import iso_time
from fte_sniff.session.stats_json import findings_json

if TYPE_CHECKING:
    from fte_sniff.analysis.findings import Report


@grouped_command(name="findings", short_help="What is wrong in files: cause, motor, span, rows.")
@input_options(filters=False)
@text_or_json_option
@many_files_options
def command(
    query: InputQuery, form: str, pair: bool, jobs: int | None, cluster: str | None
) -> None:
    """Find the spans of time in which something is wrong, all files together, best first.

    Unanswered and late commands, damage, silence, ERROR and ONLINE flags, motors that do not follow
    their targets, irregular commands, jumps of values, lost ports. Each finding names the command
    that shows its rows. All rows are needed to see what is missing, so there is no --filter.

    \b
    fte-sniff findings samples/motor3.mcap
    fte-sniff findings logs/ --from -10m
    fte-sniff findings samples/motor3.mcap --format json
    """
    from fte_sniff.analysis.events import ANALYSIS
    from fte_sniff.analysis.findings import find

    check_inputs(query.files)
    counts, measured = measure(query, ANALYSIS, ManyFiles(pair, jobs, cluster))
    report = find(counts)
    if form == "json":
        print_json(findings_json(report))
    else:
        set_language(load_settings().language())
        for line in _lines(report, query, measured.reading.source.zone):
            click.echo(printable(line))
    measured.finish()


def _lines(report: Report, query: InputQuery, zone: tzinfo) -> Iterator[str]:
    found = report.found
    days = {iso_time(t_ns, zone)[:10] for one in found for t_ns in (one.first_ns, one.last_ns)}
    for number, one in enumerate(found, 1):
        first, last = (iso_time(t_ns, zone)[:19] for t_ns in (one.first_ns, one.last_ns))
        if len(days) == 1:
            first, last = first[11:], last[11:]
        yield f"{number}. {one.about}, {first} to {last}"
        yield f"   {_(one.text)}"
        if STDIN not in query.files:
            yield f"   {query.view_command(one.decided_ns, one.filter)}"
    yield from (_(one) for one in report.coverage())
