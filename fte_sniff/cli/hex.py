"""`fte-sniff hex`: decode pasted bytes field by field.

Imports nothing heavy: users run it for one frame and wait for it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from shutil import get_terminal_size

import click

from fte_sniff.cli.output import format_option
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, InputTextError, UsageError
from fte_sniff.formats.logs.hex_log import HexLog, at_own_times
from fte_sniff.formats.logs.text_lines import Piece
from fte_sniff.formats.writers import OutputFormat, RowWriter, row_writer
from fte_sniff.protocol import Frame, Framer, Row

PORT_NAME = "hex"
"""The port of rows from the command line."""


@click.command(name="hex", short_help="Decode pasted bytes, field by field.")
@click.argument("text", nargs=-1, metavar="BYTES...")
@format_option(None)
def command(text: tuple[str, ...], form: OutputFormat | None) -> None:
    """Decode pasted bytes, field by field; without any, or with '-', from standard input.

    Accepts spaces or none, commas, 0x, \\x, colons, upper or lower case, several frames, bytes
    between them, lines of a serial assistant, hex dumps, and arrays of C, Python and JSON.
    Ambiguous input is refused with a reason; guesses are reported on standard error.

    \b
    fte-sniff hex AA 02 02 03 E8 00 00 27 10 EE
    fte-sniff hex "0x55,0x01,0x01,0x03,0xE8,0x00,0x00,0x00,0x0F,0xEE" --format jsonl
    """
    writer = _dissection() if form is None else row_writer(form, sys.stdout, ports=False)
    log = _log_of(text)
    try:
        for rows in _rows_of(log):
            log.compare((row.offset, row.raw[0]) for row in rows if isinstance(row, Frame))
            writer.write(rows)
    except InputTextError as error:
        raise _file_name_error(text) or error from error
    writer.close()
    for doubt in log.doubts:
        print_err(f"fte-sniff: {doubt}")


def _dissection() -> RowWriter:
    from os import environ

    from fte_sniff.formats.text_table import DissectionWriter

    colored = sys.stdout.isatty() and not environ.get("NO_COLOR")
    width = get_terminal_size().columns if sys.stdout.isatty() else None
    return DissectionWriter(sys.stdout, width, colored=colored)


def _rows_of(log: HexLog) -> Iterator[list[Row]]:
    """Rows of the input; an input without bytes is a UsageError."""
    framer = Framer(PORT_NAME)
    some = False
    try:
        for chunk in at_own_times(log, framer):
            some = True
            yield framer.feed(chunk)
    except FileError as error:
        raise FileError(
            f"{log.name}: holds no text; if it holds raw bytes, try: fte-sniff decode - --input raw"
        ) from error
    if not some:
        raise UsageError(
            f"no bytes on {log.name}; try: fte-sniff hex AA 01 01 03 E8 00 00 00 00 EE"
        )
    yield framer.flush()


def _log_of(words: tuple[str, ...]) -> HexLog:
    if "-" in words and len(words) > 1:
        raise UsageError("'-' reads standard input; give either that or bytes, not both")
    if words in ((), ("-",)):
        if sys.stdin.isatty():
            print_err("paste the bytes, then press Enter and Ctrl-D")
        return HexLog.of_stream(sys.stdin.buffer, "standard input")
    lines = enumerate(" ".join(words).splitlines(), start=1)
    return HexLog((Piece(line, number, 0) for number, line in lines), "the command line")


def _file_name_error(words: tuple[str, ...]) -> UsageError | None:
    """The error for an argument that is a file name instead of bytes; None if it is not."""
    from os.path import isfile

    # Path.is_file raises if a long paste is not a valid file name.
    if len(words) == 1 and isfile(words[0]):  # noqa: PTH113
        return UsageError(f"{words[0]} is a file; try: fte-sniff decode {words[0]}")
    return None
