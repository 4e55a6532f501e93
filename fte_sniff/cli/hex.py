"""Owns `fte-sniff hex`: bytes that somebody pasted, taken apart at once.

It must load nothing heavy: people run it for one frame and wait for it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from shutil import get_terminal_size

import click

from fte_sniff.cli.outputs import format_option
from fte_sniff.errors import InputTextError, UsageError
from fte_sniff.formats.hex_text import bytes_of_text
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.protocol import Chunk, Framer, Row

PORT_NAME = "hex"
"""The port of rows that came from the command line."""


@click.command(name="hex", short_help="Take pasted bytes apart, field by field.")
@click.argument("text", nargs=-1, metavar="BYTES...")
@format_option(None)
def command(text: tuple[str, ...], form: OutputFormat | None) -> None:
    r"""Decode bytes given as hex, field by field; '-' reads them from standard input.

    Spaces or none, commas, 0x, \x, colons, upper or lower case, several frames, bytes between them,
    lines from a serial assistant: as people paste it.

    \b
    fte-sniff hex AA 02 02 03 E8 00 00 27 10 EE
    fte-sniff hex "0x55,0x01,0x01,0x03,0xE8,0x00,0x00,0x00,0x0F,0xEE" --format jsonl
    """
    rows = rows_of(_bytes_of(text))
    if form is not None:
        writer = row_writer(form, sys.stdout, ports=False)
        writer.write(rows)
        writer.end()
        return
    from fte_sniff.formats.dissection import dissection_lines

    width = get_terminal_size().columns if sys.stdout.isatty() else None
    click.echo("\n".join(dissection_lines(rows, width)), color=_colors())


def rows_of(data: bytes) -> list[Row]:
    """The rows of a whole stream given at once."""
    framer = Framer(PORT_NAME)
    return [*framer.feed(Chunk(PORT_NAME, None, data)), *framer.flush()]


def _bytes_of(words: tuple[str, ...]) -> bytes:
    if words == ("-",) or (not words and not sys.stdin.isatty()):
        data = b"".join(_bytes_of_stdin())
        source = "standard input"
    else:
        data = _bytes_of_words(words)
        source = "the command line"
    if not data:
        raise UsageError(f"no bytes on {source}; try: fte-sniff hex AA 01 01 03 E8 00 00 00 00 EE")
    return data


def _bytes_of_stdin() -> Iterator[bytes]:
    from fte_sniff.formats.raw import hex_stream_chunks

    for chunk in hex_stream_chunks(sys.stdin.buffer, "standard input"):
        yield chunk.data


def _bytes_of_words(words: tuple[str, ...]) -> bytes:
    try:
        return bytes_of_text(" ".join(words))
    except InputTextError as error:
        from pathlib import Path

        if len(words) == 1 and Path(words[0]).is_file():
            raise UsageError(f"{words[0]} is a file; try: fte-sniff decode {words[0]}") from error
        raise


def _colors() -> bool | None:
    """False where NO_COLOR asks for none; None lets the terminal decide."""
    from os import environ

    return False if environ.get("NO_COLOR") else None
