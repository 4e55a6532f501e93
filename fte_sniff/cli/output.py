"""Format options, JSON for people, and the summary at the end."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, tzinfo
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, printable
from fte_sniff.formats.writers import printable_json
from fte_sniff.protocol import Gap, Status, iso_time, status_of

if TYPE_CHECKING:
    from fte_sniff.analysis.tally import Tally
    from fte_sniff.cli.options import Decorator
    from fte_sniff.session.inputs import InputReading
    from fte_sniff.session.notes import Notes


def format_option(help_text: str, forms: Iterable[str], default: str | None = None) -> Decorator:
    """The `--format` option; its value is one of the forms, or None if not given and no default."""
    return click.option(
        "--format",
        "form",
        type=click.Choice(list(map(str, forms))),
        default=default,
        show_default=default is not None,
        help=help_text,
    )


rows_format_option = partial(
    format_option, "Format of the rows; a table has no colours if the output is not a terminal."
)
"""The `--format` option of a command whose rows may have some forms of `OutputFormat`."""

list_format_option = format_option(
    "A table for people, or one JSON object per line.", ["table", "jsonl"], "table"
)


def text_or_json_option(page: str) -> Decorator:
    """The `--format` option of a command that prints text, or the JSON object of a page."""
    return format_option(f"Text for people, or one JSON object ({page}).", ["text", "json"], "text")


def print_json(value: Any) -> None:
    """Print indented JSON on standard output, without a copy of the whole text."""
    encoder = json.JSONEncoder(ensure_ascii=False, indent=2)
    sys.stdout.writelines(map(printable_json, encoder.iterencode(value)))
    sys.stdout.write("\n")


ENOUGH_ROWS = 5
"""This many damaged rows without a frame point to a wrong setup."""


def summary(
    tally: Tally,
    reading: InputReading | None = None,
    unframed: int = 0,
    limit: int | None = None,
) -> str:
    """Summary of all rows: `512 rows, 3 malformed (0.6 %: truncated 2, noise 1), 10.2 s from ...`.

    With `reading`, whose rows the tally counts, it reports their gaps. `unframed` bytes were
    received but not decoded, because the capture ended; `limit` is its largest number of rows.
    """
    if reading is not None and reading.written == reading.limit:
        read = f"{tally.rows:,} rows read so far, {reading.written:,} written"
        return f"stopped at the limit: {read}"
    parts = [f"{tally.rows:,} row{'s' if tally.rows != 1 else ''}"]
    if reading is not None and reading.written != tally.rows:
        parts[0] += f" read, {reading.written:,} written"
    parts += [
        text for status in (Status.SUSPECT, Status.MALFORMED) if (text := _share(tally, status))
    ]
    if len(parts) == 1 and tally.rows:
        parts.append("nothing malformed")
    gaps = reading.reported_gaps if reading is not None else []
    if unframed:
        after = "after the limit " if tally.rows == limit else ""
        parts.append(f"{unframed:,} bytes {after}not decoded")
    advice = "" if unframed else explain_no_frames(tally, reading)
    lacking = f"; {gap_text(gaps)} left out when recorded" if gaps else ""
    zone = UTC if reading is None else reading.source.zone
    return ", ".join(parts) + _span(tally, zone) + lacking + (advice and f"; {advice}")


def gap_text(gaps: Sequence[Gap]) -> str:
    """`893 rows in 2 places`; `893 rows and more` if the size of a gap is unknown."""
    rows, places = sum(gap.rows or 0 for gap in gaps), len(gaps)
    text = f"{rows:,} row{'s' * (rows != 1)}"
    if any(gap.rows is None for gap in gaps):
        text = f"{text} and more" if rows else "an unknown number of rows"
    return f"{text} in {places:,} place{'s' * (places != 1)}"


def explain_no_frames(tally: Tally, reading: InputReading | None = None) -> str:
    """Why rows or frames are missing, or what to check; empty otherwise."""
    if reading is not None:
        if not tally.rows and reading.span is not None:
            return "no row is between --from and --to"
        if not tally.rows and reading.notes:
            return ""  # the notes name the reason
        if not tally.rows and (selections := reading.source.selections):
            wanted = " and ".join(printable(one.filter_text) for one in selections)
            return f"nothing was selected when the recording was written: {wanted}"
        if not tally.rows and reading.reported_gaps:
            return ""  # rows came, but were left out when recorded
        if tally.rows and not reading.written and reading.row_filter is not None:
            return f"none of them matches the filter: {printable(reading.row_filter.text)}"
    if not tally.rows:
        return "nothing came: check the wire, the ground and the baud rate"
    if tally.rows >= ENOUGH_ROWS and not tally.frames:
        return "no frame found: check the controller, the baud rate and the polarity"
    return ""


def print_saved(notes: Notes) -> None:
    """Print where the notes of a view are, and try again to save those that are not."""
    if trouble := notes.save():
        print_err(trouble)
    for path in notes.written:
        print_err(f"notes are in {path}")


def print_notes(reading: InputReading) -> None:
    """Print what is wrong with the inputs, one line each, on standard error."""
    for note in reading.notes:
        print_err(f"fte-sniff: {note}")


def exit_if_unreadable(reading: InputReading) -> None:
    """Exit with the code of a file error if one of several inputs could not be read."""
    if reading.unreadable:
        sys.exit(FileError.exit_code)


def _share(tally: Tally, status: Status) -> str:
    count = tally.by_status()[status].rows
    if not count:
        return ""
    counts = tally.by_fault()
    faults = ", ".join(
        f"{fault} {counts[fault].rows:,}" for fault in tally.faults if status_of((fault,)) is status
    )
    return f"{count:,} {status} ({count / tally.rows:.2%}: {faults})"


def _span(tally: Tally, zone: tzinfo) -> str:
    if tally.first_ns is None or tally.duration_ns is None:
        return ""
    return f", {tally.duration_ns / 1e9:,.3f} s from {iso_time(tally.first_ns, zone)}"
