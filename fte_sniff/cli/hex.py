"""`fte-sniff hex`: decode pasted bytes field by field.

Imports nothing heavy: users run it for one frame and wait for it.
"""

from __future__ import annotations

import sys
from io import BytesIO

import click

from fte_sniff.cli.options import rows_format_option
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, InputTextError, UsageError
from fte_sniff.formats.plain_hex import is_hex_line, plain_hex
from fte_sniff.formats.writers import TEXT_FORMATS, OutputFormat
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Rows
from fte_sniff.session.framing import rows_of_chunks
from fte_sniff.session.save import ExportSource, text_writer

PORT_NAME = "hex"


@click.command(name="hex", short_help="Decode pasted bytes, field by field.")
@click.argument("text", nargs=-1, metavar="[BYTES]...")
@rows_format_option(TEXT_FORMATS)
def command(text: tuple[str, ...], form: str | None) -> None:
    """Decode pasted bytes, field by field; without any, or with '-', from standard input.

    Accepts spaces or none, commas, 0x, \\x, colons, upper or lower case, several frames, bytes
    between them, lines of a serial assistant, hex dumps, and arrays of C, Python and JSON.
    Ambiguous input is refused with a reason; guesses are reported on standard error.

    \b
    fte-sniff hex AA 02 02 03 E8 00 00 27 10 EE
    fte-sniff hex "0x55,0x01,0x01,0x03,0xE8,0x00,0x00,0x00,0x0F,0xEE" --format jsonl
    """
    write = text_writer(OutputFormat(form) if form else None, sys.stdout, ExportSource())
    notes: list[str] = []
    try:
        for rows in _rows_of(text, notes):
            write(rows)
    except InputTextError as error:
        raise _file_name_error(text) or error from error
    for note in notes:
        print_err(f"fte-sniff: {note}")


def _rows_of(words: tuple[str, ...], notes: list[str]) -> list[Rows]:
    """Rows of the input; an input without bytes is a UsageError."""
    data = _bytes_of(words)
    text = data.decode("utf-8", "replace")
    if not all(map(is_hex_line, text.splitlines())):
        return _rows_of_log(data, text, notes)
    chunk = Chunk(PORT_NAME, None, b"".join(plain_hex(text)))
    if not chunk.data:
        source = "standard input" if words in ((), ("-",)) else "the command line"
        raise UsageError(f"no bytes on {source}; try: fte-sniff hex AA 01 01 03 E8 00 00 00 00 EE")
    return list(rows_of_chunks([chunk], notes.append))


def _rows_of_log(data: bytes, text: str, notes: list[str]) -> list[Rows]:
    """Rows of a text with other words than hex, which is an InputTextError without frames."""
    from fte_sniff.formats.known_files import refuse_known
    from fte_sniff.formats.log import Log
    from fte_sniff.formats.log_text import is_text

    refuse_known("standard input", data)
    if not is_text(data):
        raise FileError(
            "standard input: holds no text; if it holds raw bytes, try: fte-sniff decode -"
            " --input raw"
        )
    try:
        log = Log(PORT_NAME, stream=BytesIO(data))
        rows = list(rows_of_chunks(log.chunks(), notes.append))
    except InputTextError:
        list(plain_hex(text))  # names the first character that is not hex
        raise
    notes += log.notes()
    return rows


def _bytes_of(words: tuple[str, ...]) -> bytes:
    if "-" in words and len(words) > 1:
        raise UsageError("'-' reads standard input; give either that or bytes, not both")
    if words in ((), ("-",)):
        if sys.stdin.isatty():
            print_err("paste the bytes, then press Enter and Ctrl-D")
        return sys.stdin.buffer.read()
    return " ".join(words).encode("utf-8", "surrogateescape")


def _file_name_error(words: tuple[str, ...]) -> UsageError | None:
    """The error for an argument that is a file name instead of bytes; None if it is not."""
    from os.path import isfile

    # Path.is_file raises if a long paste is not a valid file name.
    if len(words) == 1 and isfile(words[0]):  # noqa: PTH113
        return UsageError(f"{words[0]} is a file; try: fte-sniff decode {words[0]}")
    return None
