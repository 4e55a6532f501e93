"""`fte-sniff report`: files as one HTML page with plots, for a browser."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from fte_sniff.cli.input_files import (
    STDIN,
    InputQuery,
    check_inputs,
    exit_if_unreadable,
    explain_no_frames,
    input_options,
    output_options,
    print_notes,
)
from fte_sniff.cli.options import grouped_command, install_command
from fte_sniff.cli.settings import lang_option, load_settings
from fte_sniff.cli.streams import print_err, progress_line
from fte_sniff.errors import UsageError, unwritable
from fte_sniff.protocol import DEFAULT_BAUD
from fte_sniff.session.save import replace_file

if TYPE_CHECKING:
    from fte_sniff.analysis.plots import Timeline
    from fte_sniff.analysis.statistics import StatisticsSummary
    from fte_sniff.session.inputs import InputReading

_DELAY_BINS = 60
_SUFFIXES = (".html", ".htm")


@grouped_command(name="report", short_help="One HTML page with plots, to send to a colleague.")
@input_options
@output_options("The HTML file, such as report.html.", required=True)
@lang_option
def command(query: InputQuery, output: Path, force: bool, lang: str | None) -> None:
    """Write a page about recordings, raw bytes or hex text; it needs no network.

    Per motor, target and actual speed and position over time with ERROR, ONLINE and commands;
    faults over time; answer delays; the numbers of `stats`; the first rows of each fault. Drag
    over a plot to zoom in.

    \b
    fte-sniff report samples/damaged.mcap -o report.html
    fte-sniff report logs/ --from -10m -o last.html
    """
    check_inputs(query.files, output)
    _check_suffix(output)
    try:
        from fte_sniff.cli.report_page import ReportFacts, page, title_of
    except ModuleNotFoundError as error:
        raise UsageError(
            f"report needs {error.name}, which is not installed; install it with"
            f" `{install_command('report')}`"
        ) from error
    from fte_sniff.analysis.plots import Timeline
    from fte_sniff.i18n import set_language
    from fte_sniff.session.stats_json import statistics_json

    language = load_settings(None).language(lang)
    set_language(language)
    if output.is_file() and not force:
        raise unwritable(output, FileExistsError())
    timeline = Timeline()
    with progress_line(reads_stdin=STDIN in query.files) as line:
        reading = query.read(query.row_filter(), progress=line.progress)
        summary = _summarize(reading, query.baud, timeline)
    facts = ReportFacts(
        title_of([one.name for one in reading.inputs]),
        reading.source.gaps,
        reading.source.facts,
        reading.notes,
        _delays(summary),
        language,
        [] if summary.findings is None else summary.findings.found(),
        reading.source.zone,
    )
    text = page(timeline, statistics_json(summary, reading), facts)
    try:
        replace_file(output, text.encode())
    except OSError as error:
        raise unwritable(output, error) from error
    print_notes(reading)
    if advice := explain_no_frames(reading.tally, reading):
        print_err(f"fte-sniff: {advice}")
    print_err(f"fte-sniff: {output}: {reading.written:,} rows, {len(text) / 1e6:,.1f} MB")
    exit_if_unreadable(reading)


def _check_suffix(output: Path) -> None:
    """Check that the name of a file has no extension of another format; raises UsageError."""
    if output.suffix.lower() in ("", *_SUFFIXES) or (output.exists() and not output.is_file()):
        return
    is_number = output.suffix[1:].isdigit()  # of a name such as report-1.5
    named = output.with_name(f"{output.name}.html") if is_number else output.with_suffix(".html")
    raise UsageError(
        f"{output}: a report is HTML, and {output.suffix} is not one of {' '.join(_SUFFIXES)};"
        f" name it {named}"
    )


def _summarize(reading: InputReading, baud: int | None, timeline: Timeline) -> StatisticsSummary:
    from fte_sniff.analysis.statistics import LineSetup, StatisticsSummary

    # A filter hides rows whose absence would be a finding.
    with_findings = reading.row_filter is None
    summary = StatisticsSummary(LineSetup(baud or DEFAULT_BAUD), with_findings=with_findings)
    for one in reading.inputs:
        summary.begin(one.name)
        for batch in reading.batches_of(one):
            summary.observe(batch.rows, batch.changes)
            timeline.observe(batch.rows, batch.changes)
    return summary


def _delays(summary: StatisticsSummary) -> dict[int, list[tuple[float, float, int]]]:
    """By motor, the histogram of its answer delays: from and to, nanoseconds, and how many."""
    import numpy as np

    found: dict[int, list[tuple[float, float, int]]] = {}
    motors = summary.answers.stats() if summary.in_order else []
    known = [one for one in motors if one.delays.longest_ns]
    if not known:
        return found
    low = min(one.delays.percentile_ns(0.001) or 1.0 for one in known)
    high = max(one.delays.longest_ns or 1 for one in known)
    edges = np.geomspace(max(low * 0.95, 1.0), max(high * 1.05, 2.0), _DELAY_BINS + 1).tolist()
    for one in known:
        bins = [(start, end, one.delays.between(start, end)) for start, end in pairwise(edges)]
        found[one.motor] = [each for each in bins if each[2]]
    return found
