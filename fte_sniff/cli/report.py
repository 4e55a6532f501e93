"""`fte-sniff report`: files as one HTML page with plots, for a browser."""

from __future__ import annotations

import sys
from pathlib import Path

from fte_sniff.cli.input_files import InputQuery, input_options, output_options
from fte_sniff.cli.measuring import finish, headline, measure
from fte_sniff.cli.options import grouped_command
from fte_sniff.cli.settings import lang_option, load_settings
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, printable, unwritable
from fte_sniff.session.save import replace_file

_SUFFIXES = (".html", ".htm")


@grouped_command(name="report", short_help="One HTML page with plots, to send to a colleague.")
@input_options()
@output_options("The HTML file, such as report.html.", required=True)
@lang_option
def command(query: InputQuery, output: Path, force: bool, lang: str | None) -> None:
    """Write a page about recordings, raw bytes or hex text; it needs no network.

    It has the findings, the numbers of `stats`, and plots: faults, and for each motor the target
    and actual speed and position, with ERROR and ONLINE. Drag over a plot to zoom in.

    \b
    fte-sniff report samples/damaged.mcap -o report.html
    fte-sniff report logs/ --from -10m -o last.html
    """
    if output.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{output}: a report is HTML; name it {output.with_suffix('.html')}")
    try:
        from fte_sniff.cli.report_page import counted, page, title_of
    except ModuleNotFoundError as error:
        raise UsageError(
            f"report needs {error.name}: `{sys.executable} -m pip install 'fte-sniff[report]'`"
        ) from error
    from fte_sniff.analysis import events, statistics
    from fte_sniff.analysis.findings import find
    from fte_sniff.cli.stats import report_lines
    from fte_sniff.i18n import _, set_language
    from fte_sniff.session.measured import together
    from fte_sniff.session.stats_json import statistics_json

    set_language(load_settings().language(lang))
    if output.is_file() and not force:
        raise unwritable(output, FileExistsError())
    counts, reading = measure(query, together(events.counted, statistics.counted, counted))
    numbers = statistics_json(counts, reading, query.filter_text, query.baud)
    # A filter hides rows whose absence would be a finding.
    findings = find(counts).found if query.filter_text is None else []
    zone = reading.zone
    texts = {
        "findings": "\n".join(f"{headline(one, (), zone)}: {_(one.text)}" for one in findings),
        "statistics": "\n".join(line.plain for line in report_lines(numbers, reading)),
        "notes": "\n".join(map(printable, reading.notes)),
    }
    shown = {heading: text for heading, text in texts.items() if text}
    text = page(title_of([one.name for one in reading.inputs]), shown, counts)
    try:
        replace_file(output, text.encode())
    except OSError as error:
        raise unwritable(output, error) from error
    size = f"{numbers['rows']:,} rows, {len(text) / 1e6:,.1f} MB"
    print_err(f"fte-sniff: {output}: {size}")
    finish(reading)
