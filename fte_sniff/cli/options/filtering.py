"""Owns `--filter`: from its text to what picks rows, loading the filter only where one is given.

It must not know the filter's language.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

from fte_sniff.protocol import Row

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


def _explain(context: click.Context, _option: click.Parameter, text: str | None) -> str | None:
    if text is None or text.strip().lower() != "help":
        return text
    from fte_sniff.analysis.filter.terms import FILTER_HELP

    click.echo(FILTER_HELP)
    return context.exit()


filter_option = click.option(
    "--filter",
    "filter_text",
    metavar="EXPR",
    is_eager=True,
    callback=_explain,
    help="Only rows for which this holds: motor = 1 AND rpm > 500. '--filter help' tells more.",
)
"""The `--filter` option, as every command that shows rows has it."""


def row_filter(text: str | None) -> RowFilter | None:
    """The filter that `--filter` asks for; None where it was not given.

    Raises:
        FilterError: the filter cannot be read.
    """
    if text is None:
        return None
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(text)


def selection(text: str | None) -> Callable[[Sequence[Row]], list[Row]]:
    """What picks the rows for which the filter holds; all of them where there is none.

    Raises:
        FilterError: the filter cannot be read.
    """
    wanted = row_filter(text)
    return list if wanted is None else wanted.select
