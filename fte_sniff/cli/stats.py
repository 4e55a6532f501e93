"""`fte-sniff stats`: statistics over files, as text or as one JSON object."""

from __future__ import annotations

from functools import partial

import click

from fte_sniff.cli.input_files import InputQuery, check_inputs, input_options
from fte_sniff.cli.measuring import jobs_options, measure
from fte_sniff.cli.output import print_json, text_or_json_option
from fte_sniff.protocol import DEFAULT_BAUD
from fte_sniff.session.stats_json import statistics_json


@click.command(name="stats", short_help="Statistics over files: rates, faults, silences, answers.")
@input_options
@text_or_json_option("docs/stats.md")
@jobs_options
def command(query: InputQuery, form: str, jobs: int | None, cluster: str | None) -> None:
    """Print statistics over recordings, raw bytes or hex text, all files together.

    Duration, rows and bytes, use and silences of each line; faults by kind; rate, period, jitter
    and values of each kind of frame by motor; answer times and flags seen. With --filter, only
    matching rows are counted.

    \b
    fte-sniff stats samples/damaged.mcap
    fte-sniff stats logs/ --from -10m
    fte-sniff stats samples/clean.mcap --format json
    """
    from fte_sniff.analysis.statistics import LineSetup, StatisticsSummary

    check_inputs(query.files)
    # A filter hides rows whose absence would be a finding.
    with_findings = form == "text" and query.filter_text is None
    setup = LineSetup(query.baud or DEFAULT_BAUD)
    make = partial(StatisticsSummary, setup, with_findings=with_findings)
    summary, measured = measure(query, make, jobs, cluster)
    if form == "json":
        print_json(statistics_json(summary, measured.reading))
    else:
        from fte_sniff.cli.stats_report import print_lines, report_lines

        print_lines(partial(report_lines, summary, measured.reading))
        if summary.findings is not None and (found := summary.findings.found()):
            click.echo(f"\nfindings   {len(found)}; see: fte-sniff findings")
    measured.finish()
