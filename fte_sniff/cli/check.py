"""`fte-sniff check`: a verdict about files, for acceptance tests and CI."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from fte_sniff.cli.check_report import FORMS, print_verdicts, read_rules
from fte_sniff.cli.input_files import InputQuery, check_inputs, input_options
from fte_sniff.cli.measuring import jobs_options, measure
from fte_sniff.cli.options import FileName
from fte_sniff.cli.output import format_option


@click.command(name="check", short_help="A verdict about files: pass, fail, or not covered.")
@input_options
@click.option("--rules", type=FileName(), help="Rules of a TOML file (docs/check.md).")
@click.option(
    "--expect",
    "expectations",
    multiple=True,
    metavar="RULE",
    help='A rule, such as "count(malformed) == 0"; may be repeated.',
)
@format_option(
    "A table for people, one JSON object (docs/check.md), or JUnit XML.", FORMS, FORMS[0]
)
@jobs_options
def command(
    query: InputQuery,
    rules: Path | None,
    expectations: tuple[str, ...],
    form: str,
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
    from fte_sniff.analysis.rules import RuleCheck

    check, measured = measure(query, partial(RuleCheck, wanted), jobs, cluster)
    print_verdicts(check, form, measured.reading, query)
    measured.finish(refused=any(one.refuses for one in check.verdicts()))
